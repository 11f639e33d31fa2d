"""Repeats DroQ's published experiment: `python -m experiments.reproduce_droq --run runs/droq`."""

import pathlib
from typing import Annotated

from eihrl_jax import robots
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import limits
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import wrappers
from eihrl_jax.envs.published import forward_run
from eihrl_jax.physics import engines
from eihrl_jax.training import baselines

ANT = pathlib.Path(robots.__file__).parent / "assets" / "gym_ant.toml"


@limits.dataclass
class ReproduceConfig:
    """Lets Gym's ant learn to run with the settings of DroQ's released code.

    One environment, 20 critic updates per control step at batch 256, 5,000 random steps first. The
    published return is 2,000 after 60 to 80 thousand steps, 3,000 after 80 to 100 thousand and
    4,000 after about 120 thousand. metrics.csv holds `eval/return`, of 10 episodes without
    exploration every 1,000 steps. Gym's ant is integrated by Runge-Kutta, this one by MuJoCo's
    implicit integrator with the same step.

    Attributes:
      seed: of every random number of the run.
      num_steps: control steps.
      run: run folder.
      resume: go on with the run that the folder holds.
    """

    seed: limits.Seed = 0
    num_steps: Annotated[int, limits.Range(1, 10_000_000)] = 120_000
    run: pathlib.Path = pathlib.Path("runs/droq-published")
    resume: bool = False


def main(config: ReproduceConfig) -> None:
    """Trains."""
    options = baselines_config.FlatConfig(
        method="droq",
        seed=config.seed,
        run=config.run,
        resume=config.resume,
        maze="open floor",
        robot=str(ANT),
        num_envs=1,
        num_steps=config.num_steps,
        # A row of metrics and an evaluation every 1,000 control steps.
        iterations_per_round=100,
        log_rounds=10,
        evaluate_every=1,
        checkpoint_every=5,
        num_eval_episodes=10,
        learner=low_config.Droq(),
    )

    engine = engines.make(robots.load(str(ANT)), "mujoco")
    # Open floor has no sides, and flat DroQ asks for none.
    env, side_xy = forward_run.ForwardRun(engine), (0, 0)
    num_actions, steps = engine.model.nu, forward_run.EPISODE_STEPS
    world = World(wrappers.AutoReset(env), num_actions, side_xy, steps)
    learner = interface.make(world, options)
    arena = baselines.Arena("DroQ on Gym's ant", env, side_xy, learner, steps)
    baselines.train_in(arena, options)
