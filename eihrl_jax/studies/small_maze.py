"""Trains the two-level baselines in a small point maze: `python -m experiments.small_maze`."""

import dataclasses
import itertools
import pathlib

from eihrl_jax import base
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import checks, presets
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import higl as higl_config
from eihrl_jax.drawing import curves
from eihrl_jax.reporting import cached_runs
from eihrl_jax.training import baselines

METHODS = ("hiro", "hrac", "higl", "hess")

MAZE = """\
#####
#1SS#
###S#
#SSS#
#####
"""
"""A U of 3x3 cells; the robot starts anywhere."""

NAME = "u5"


@dataclasses.dataclass(frozen=True, kw_only=True)
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

    methods: tuple[str, ...] = METHODS
    seeds: tuple[int, ...] = (0, 1, 2)
    out: pathlib.Path = pathlib.Path("runs/small")

    def __post_init__(self) -> None:
        """Checks names and ranges."""
        checks.each_of("methods", self.methods, METHODS)
        checks.seeds(self.seeds)


def main(config: SmallConfig) -> None:
    """Trains what is missing, then tells how far each has come.

    Raises:
      base.UserError: the folder holds something else.
    """
    config.out.mkdir(parents=True, exist_ok=True)
    maze = config.out / f"{NAME}.txt"
    if maze.exists() and maze.read_text() != MAZE:
        raise base.UserError(f"{maze} is another maze than is trained in: name another --out")
    maze.write_text(MAZE)
    runs = [
        options_of(config, method, seed)
        for seed, method in itertools.product(config.seeds, config.methods)
    ]
    for options in runs:
        cached_runs.finish(options, baselines.train)
    for options in sorted(runs, key=lambda options: METHODS.index(options.method)):
        success = curves.read(options.run / "metrics.csv", "step", "eval/success")[-1, 1]
        print(f"{options.method}, seed {options.seed}: {success:.0%} after {options.num_steps:,}")


def options_of(config: SmallConfig, method: str, seed: int) -> baselines_config.BaselineConfig:
    """Returns the options of one run."""
    preset = presets.BASELINES[method]
    if isinstance(preset, hess_config.HessConfig):
        preset = _short_hess(preset)
    else:
        assert isinstance(preset, higl_config.HiglConfig)
        preset = _short_higl(preset)
    return dataclasses.replace(
        preset,
        maze=str(config.out / f"{NAME}.txt"),
        robot="point",
        seed=seed,
        run=config.out / cached_runs.name(method, NAME, "sparse", seed),
        resume=True,
    )


def _short_higl(preset: higl_config.HiglConfig) -> higl_config.HiglConfig:
    """Returns HIRO, HRAC or HIGL with subgoals of a point's size.

    HRAC and HIGL take 60,000 control steps; what holds the manager back is learned and begins
    early. HIRO, which nothing holds back, takes 150,000.
    """
    preset = dataclasses.replace(
        preset,
        num_steps=60_000,
        is_limit_terminal=False,
        manager=dataclasses.replace(preset.manager, reach=3.0),
        controller=dataclasses.replace(
            preset.controller, reach=1.0, noise=0.3, target_noise=0.1, target_clip=0.3
        ),
    )
    if preset.guidance == "none":
        return dataclasses.replace(preset, num_steps=150_000, updates_per_step=0.5)
    preset = dataclasses.replace(
        preset, adjacency=dataclasses.replace(preset.adjacency, period=10_000)
    )
    if preset.guidance == "adjacency":
        return preset
    return dataclasses.replace(
        preset,
        landmark_distance=0.5,
        adjacency=dataclasses.replace(preset.adjacency, steps=6),
        landmarks=higl_config.Landmarks(first_step=10_000),
    )


def _short_hess(preset: hess_config.HessConfig) -> hess_config.HessConfig:
    """Returns HESS with smaller networks and schedules for 200,000 control steps.

    A point crosses some 30 units of the subgoal space in a period, so that the released reward of
    the controller would leave the values that its critic can tell. It begins anywhere, and success
    from nearby must not end the exploration.
    """
    return dataclasses.replace(
        preset,
        num_steps=200_000,
        random_steps=30_000,
        controller=dataclasses.replace(
            preset.controller,
            hidden=(128, 128),
            critic_hidden=(128, 128, 128),
            updates_per_step=1 / 3,
            reward_scale=0.02,
        ),
        representation=dataclasses.replace(preset.representation, every=30_000, num_updates=10_000),
        exploration=dataclasses.replace(
            preset.exploration,
            first_step=30_000,
            potential_step=60_000,
            every=6_000,
            success_weight=1.0,
        ),
    )
