"""Named settings: `paper` follows the paper, `best` has the best results; never mixed.

>>> tuple(HIGH), tuple(BASELINES)
(('best', 'paper'), ('droq', 'higl', 'hrac', 'hiro', 'hess', 'ppo', 'sac'))
"""

import dataclasses

from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import brax as brax_config
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import higl as higl_config
from eihrl_jax.config import low as low_config


def low_paper() -> low_config.LowConfig:
    """The low level as in the paper: world frame, two-hot direction, eq. 1 alone.

    DroQ's numbers are those of its authors' code for the ant (Hiraoka et al. 2021); the paper names
    none. Alpha is 3 (Table 4).
    """
    return low_config.LowConfig(preset="paper")


def low_best() -> low_config.LowConfig:
    """The low level with everything that makes epsilon small in short training.

    Observations are in the canonical frame, with displacement and time left; the reward is for
    coming nearer to the point one cell ahead; half of the rooms have inner walls; and many
    environments run at once.
    """
    return low_config.LowConfig(
        preset="best",
        # 640,000 control steps in all, where the paper's preset takes 400,000 of one robot.
        num_envs=64,
        num_iterations=10_000,  # 640,000 steps of a robot, all of which the replay keeps
        warmup_iterations=200,
        updates_per_iteration=8,  # for 64 steps, where DroQ has 20 for one
        capacity=640_000,
        relabel_share=0.5,
        num_rooms=256,
        low_input=low_config.LowInput(frame="canonical", use_progress=True, velocity_scale=0.1),
        reward=low_config.LowReward(lateral_weight=1.0, beyond_cell=-1.0),
        droq=low_config.Droq(actor_period=2, temperature=0.02, average_rate=0.002),
        log_every=50,
        evaluate_every=500,
        checkpoint_every=1_000,
    )


def low_restarting() -> low_config.LowConfig:
    """`best`, with half of the replayed steps turned into the first step of a new subgoal."""
    return dataclasses.replace(low_best(), relabel="restart")


def low_point() -> low_config.LowConfig:
    """`low_restarting` for the point robot, on open floor alone; a minute on one core.

    The point doesn't see walls: steps in which they hold it make the values less precise.
    """
    return dataclasses.replace(
        low_restarting(),
        preset="point",
        robot="point",
        num_iterations=2_000,
        capacity=128_000,  # the whole run
        num_rooms=0,  # open floor
        droq=dataclasses.replace(low_best().droq, hidden=(64, 64)),
    )


def low_swimmer() -> low_config.LowConfig:
    """`low_restarting` for the swimmer, which turns slowly and needs longer training.

    It starts anywhere in a cell and follows anchored subgoals, in corridors too: otherwise walls of
    a corridor can hold it folded for dozens of subgoals.
    """
    return dataclasses.replace(
        low_restarting(),
        preset="swimmer",
        robot="swimmer",
        num_iterations=15_000,  # 960,000 steps, of which the replay keeps the last two thirds
        anchored=True,
        corridor_share=0.25,
        start_jitter=1.0,
        checkpoint_every=2_500,
    )


def low_humanoid() -> low_config.LowConfig:
    """`low_restarting` for the humanoid, which must learn not to fall before it learns to walk.

    The reward is for keeping pace (`is_paced`): rewarded for hurrying, it runs past the cell and
    falls. The actor is averaged over many updates, because its balance changes from one update to
    the next, and the learning rate decays.
    """
    best = low_restarting()
    return dataclasses.replace(
        best,
        preset="humanoid",
        robot="humanoid",
        num_iterations=75_000,
        capacity=1_280_000,  # the last quarter of 4.8 million steps
        episode_steps=1_000,  # five of its subgoals
        reward=dataclasses.replace(best.reward, fall_cost=20.0, is_paced=True),
        droq=dataclasses.replace(best.droq, average_rate=0.0005, learning_rate_half_life=150_000),
        checkpoint_every=5_000,
    )


def low_stand() -> low_config.LowConfig:
    """`best` for a robot that is thrown and has to stand up, wherever it is.

    It takes over from a walking low level while the robot is down, see `envs.recovery`.
    """
    best = low_best()
    return dataclasses.replace(
        best,
        preset="stand",
        robot="go1",
        num_iterations=5_000,
        capacity=320_000,  # the whole run
        num_rooms=0,
        episode_steps=200,  # four seconds of a Go1
        ends_at_fall=False,
        thrown_share=1.0,
        low_input=dataclasses.replace(best.low_input, use_progress=False, full_range=True),
        reward=low_config.LowReward(scale=0.0, standing=0.1),
    )


LOW = {
    "best": low_best(),
    "paper": low_paper(),
    "point": low_point(),
    "swimmer": low_swimmer(),
    "humanoid": low_humanoid(),
    "stand": low_stand(),
}
"""Presets of `train_low`, its default first."""


def high_paper() -> high_config.HighConfig:
    """The high level as in the paper: whole episodes, Monte-Carlo returns, feed-forward.

    Algorithm 1 with 64 workers; the paper names none of the learner's numbers, so they are those of
    openai/baselines `a2c`, see `config.high`.
    """
    return high_config.HighConfig(preset="paper")


def high_best() -> high_config.HighConfig:
    """The high level that searches a map of what it has seen, in mazes of any size.

    Five by five cells are in view at a time. Unseen cells attract it from the start, and a low
    entropy bonus doesn't undo that before a goal is found. Short windows give many updates in
    little time, a decaying learning rate lets the policy converge, and a discount of 0.94 favours
    short ways. Subgoals are anchored, so that offsets don't add up beside a door. In use it takes
    the most likely subgoals, because sampled ones go back and forth more and are late more often.
    """
    return high_config.HighConfig(
        preset="best",
        # Five pixels per cell, and a map of 17 x 17 cells.
        task=high_config.Task(extent=15.0, pixels=25, map_radius=8, anchored=True),
        network=high_config.Network(kind="search"),
        learner=high_config.Learner(
            num_workers=512,
            window=8,
            num_updates=100,  # 410,000 decisions: 512 workers, 8 in a window
            gamma=0.94,
            optimiser="adam",
            learning_rate=5e-3,
            learning_rate_end=2e-4,
            entropy=0.004,
            entropy_end=0.001,
        ),
        greedy=True,
        log_every=5,
        evaluate_every=10,
        num_eval_episodes=200,  # on maps of whole mazes, which take longer than training's
        checkpoint_every=50,
    )


HIGH = {"best": high_best(), "paper": high_paper()}
"""Presets of `train_high`, its default first."""


def higl() -> higl_config.HiglConfig:
    """HIGL as released (Kim et al. 2021), errors corrected, and with landmarks for our mazes.

    There are as many landmarks as the release has in its large mazes: fewer are farther apart than
    the cutoff, and the graph is disconnected. Our goals end an episode at their border, so that no
    landmark lies inside of one: so a goal is followed directly from the same distance as landmarks.
    Both levels observe the time, so the time limit counts as a terminal state, as released.
    """
    landmarks = higl_config.Landmarks(num_coverage=60, num_novel=60, near=-38.0)
    return higl_config.HiglConfig(landmarks=landmarks, is_limit_terminal=True)


def hrac() -> higl_config.HiglConfig:
    """HRAC: subgoals constrained to places reachable within a period (Zhang et al. 2020)."""
    return higl_config.HiglConfig(
        method="hrac",
        guidance="adjacency",
        adjacency=higl_config.Adjacency(steps=9),
        is_limit_terminal=True,
    )


def hiro() -> higl_config.HiglConfig:
    """HIRO: unconstrained subgoals (Nachum et al. 2018)."""
    return higl_config.HiglConfig(method="hiro", guidance="none", is_limit_terminal=True)


def hess() -> hess_config.HessConfig:
    """HESS as released (Li et al. 2021), in some points as in its paper."""
    return hess_config.HessConfig(log_rounds=1)  # a round is a whole episode


BASELINES: dict[str, baselines_config.BaselineConfig] = {
    "droq": baselines_config.FlatConfig(),
    "higl": higl(),
    "hrac": hrac(),
    "hiro": hiro(),
    "hess": hess(),
    "ppo": brax_config.PpoConfig(),
    "sac": brax_config.SacConfig(),
}
"""Methods of `train_baseline`, its default first."""
