"""Trains the two-level baselines in a small point maze: `python -m experiments.small_maze`."""

import functools
import itertools
import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import changes, limits, presets
from eihrl_jax.config import higl as higl_config
from eihrl_jax.drawing import curves
from eihrl_jax.reporting import cached_runs
from eihrl_jax.storage import reading, writing
from eihrl_jax.training import baselines

MAZE = """\
#####
#1SS#
###S#
#SSS#
#####
"""
"""A U of 3x3 cells; the robot starts anywhere."""

NAME = "u5"

_HIGL: dict[str, object] = {
    "is_limit_terminal": False,
    # Subgoals of a cell, and controls of a point's size.
    "manager.reach": 3.0,
    "controller.reach": 1.0,
    "controller.noise": 0.3,
    "controller.target_noise": 0.1,
    "controller.target_clip": 0.3,
}
"""What HIRO, HRAC and HIGL have in common."""

OPTIONS: dict[str, dict[str, object]] = {
    # Nothing holds back HIRO's manager, which takes longer to learn what can be reached.
    "hiro": _HIGL | {"num_steps": 150_000, "updates_per_step": 0.5},
    "hrac": _HIGL | {"num_steps": 60_000, "adjacency.period": 10_000},
    "higl": _HIGL
    | {
        "num_steps": 60_000,
        "adjacency.period": 10_000,
        "adjacency.steps": 6,
        "landmark_distance": 0.5,
        "landmarks": higl_config.Landmarks(first_step=10_000),
    },
    "hess": {
        "num_steps": 200_000,
        "random_steps": 30_000,
        "controller.hidden": (128, 128),
        "controller.critic_hidden": (128, 128, 128),
        "controller.updates_per_step": 1 / 3,
        # A point crosses some 30 units of the subgoal space in a period, so that the released
        # reward would leave the values that the critic can tell.
        "controller.reward_scale": 0.02,
        "representation.every": 30_000,
        "representation.num_updates": 10_000,
        "exploration.first_step": 30_000,
        "exploration.potential_step": 60_000,
        "exploration.every": 6_000,
        # A point begins anywhere, and success from nearby must not end the exploration.
        "exploration.success_weight": 1.0,
    },
}
"""What is changed of each method's preset for a point, and for schedules so short."""

METHODS = tuple(OPTIONS)


@limits.dataclass
class SmallConfig:
    """Trains each method with each seed in a small maze, as a check that it finds its way.

    Settings are the methods' own but for lengths, noise and schedules that don't fit a maze so
    small; see docs/baselines.md. Runs that the folder already holds are continued or taken as they
    are. Prints the last evaluation of each, 50 episodes without exploration.

    Attributes:
      methods: hiro, hrac, higl, hess.
      seeds: of the runs of each.
      out: folder of the maze and the runs, `<method>-u5-<seed>` each.
    """

    methods: limits.Several[Annotated[str, limits.OneOf(METHODS)]] = METHODS
    seeds: limits.Seeds = (0, 1, 2)
    out: pathlib.Path = pathlib.Path("runs/small")


def main(config: SmallConfig) -> None:
    """Trains what is missing, then prints the results of each.

    Raises:
      base.UserError: the folder holds something else.
    """
    # As a file, so that the runs can also be continued and evaluated one by one.
    config.out.mkdir(parents=True, exist_ok=True)
    maze = config.out / f"{NAME}.txt"
    if maze.exists() and reading.read_text(maze) != MAZE:
        raise base.UserError(f"{maze} is another maze than is trained in: name another --out")
    writing.write_text(maze, MAZE)

    runs = [
        options_of(config, method, seed)
        for seed, method in itertools.product(config.seeds, config.methods)
    ]
    cached_runs.share(
        functools.partial(cached_runs.finish, options, baselines.train) for options in runs
    )

    # Trained seed by seed, but told method by method.
    for options in sorted(runs, key=lambda options: METHODS.index(options.method)):
        success = curves.read(options.run / "metrics.csv", "step", "eval/success")[-1, 1]
        print(f"{options.method}, seed {options.seed}: {success:.0%} after {options.num_steps:,}")


def options_of(config: SmallConfig, method: str, seed: int) -> baselines_config.BaselineConfig:
    """Returns the options of one run."""
    own = {
        "maze": str(config.out / f"{NAME}.txt"),
        "robot": "point",
        "seed": seed,
        "run": config.out / cached_runs.name(method, NAME, "sparse", seed),
        "resume": True,
    }
    return changes.apply(presets.BASELINES[method], OPTIONS[method] | own)
