"""Repeats HIGL's published experiment: `python -m experiments.reproduce_higl --run runs/higl-u`."""

import dataclasses
import pathlib
from typing import Annotated, Literal

from eihrl_jax import base, mazes, robots
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.config import higl as higl_config
from eihrl_jax.config import limits, presets
from eihrl_jax.envs.published import u_maze
from eihrl_jax.physics import engines
from eihrl_jax.reporting import learning_curve
from eihrl_jax.training import baselines


@limits.dataclass
class ReproduceConfig:
    """Trains HIGL, HRAC or HIRO in HIGL's own maze, an ant's U with cells of four units.

    Goals are drawn anywhere in training, and the far end of the U is what is evaluated, 500 control
    steps, within 2.5 units. Published after a million steps, sparse: HIGL 65.1 %, HRAC 17.6 %.
    metrics.csv holds `eval/success` of 50 episodes every 10,000 steps (published: 5 every 5,000),
    learning_curve.png draws it; ten robots walk at the same time, and walls are a cell high.

    Attributes:
      method: higl, hrac or hiro.
      reward: sparse: 0 at the goal, else -1; dense: minus the distance.
      seed: of every random number of the run.
      num_steps: control steps.
      updates_per_step: of the controller per control step.
      run: run folder.
      resume: go on with the run that the folder holds.
    """

    method: Literal["higl", "hrac", "hiro"] = "higl"
    reward: base.Reward = "sparse"
    seed: limits.Seed = 0
    num_steps: Annotated[int, limits.Range(1, 10_000_000)] = 1_000_000
    updates_per_step: Annotated[float, limits.Range(above=0.0, high=10.0)] = 1.0
    run: pathlib.Path = pathlib.Path("runs/higl-published")
    resume: bool = False


def main(config: ReproduceConfig) -> None:
    """Trains."""
    preset = presets.BASELINES[config.method]
    assert isinstance(preset, higl_config.HiglConfig)
    options = dataclasses.replace(
        preset,
        seed=config.seed,
        run=config.run,
        resume=config.resume,
        maze="HIGL's U",
        reward=config.reward,
        num_steps=config.num_steps,
        updates_per_step=config.updates_per_step,
        # The maze pays 0 and -1 as released; time needn't cost more.
        costs_time=False,
        is_limit_terminal=False,
        landmarks=higl_config.Landmarks(),  # As many as released, not as our mazes ask for.
        evaluate_every=2,
        checkpoint_every=10,
        num_eval_episodes=50,
    )

    # Trained with goals anywhere, evaluated with the far end alone.
    engine = engines.make(robots.load("ant"), "mujoco", u_maze.CELL)
    maze = mazes.parse(u_maze.TEXT)
    env = u_maze.UMaze(engine, maze, reward=config.reward)
    test_env = u_maze.UMaze(engine, maze, reward=config.reward, is_evaluation=True)
    world = World(env, engine.model.nu, env.side_xy, u_maze.EPISODE_STEPS)
    learner = interface.make(world, options)
    title = f"{config.method} in HIGL's U"
    arena = baselines.Arena(title, test_env, env.side_xy, learner, u_maze.EPISODE_STEPS)
    baselines.train_in(arena, options)

    learning_curve.renew(config.run)
