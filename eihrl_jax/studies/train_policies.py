"""Trains every shipped high level again: `python -m experiments.train_policies`."""

import functools
import itertools
import pathlib
import shutil
from typing import Annotated

from eihrl_jax import base, mazes
from eihrl_jax.config import changes, limits, presets
from eihrl_jax.config import high as high_config
from eihrl_jax.reporting import cached_runs
from eihrl_jax.runs import folders, policies
from eihrl_jax.training import high

_Preset = Annotated[str, limits.OneOf(presets.HIGH)]
_Maze = Annotated[str, limits.OneOf(mazes.NAMES)]


@limits.dataclass
class PoliciesConfig:
    """Trains high levels, each preset in each maze with each seed.

    A run that the folder already holds is continued, or taken as it is if it is finished.

    Attributes:
      presets: of `train_high`.
      mazes: names of mazes.
      rewards: sparse, dense or both (paper, App. D).
      seeds: of the training runs.
      out: folder of the runs, `<preset>-<maze>-<seed>` each, `<preset>-<maze>-dense-<seed>` where
        the reward is dense.
      ship: copy what is finished into the package, in place of what is shipped.
    """

    presets: limits.Several[_Preset] = tuple(presets.HIGH)
    mazes: limits.Several[_Maze] = cached_runs.MAZES
    rewards: limits.Several[base.Reward] = ("sparse",)
    seeds: limits.Seeds = (0, 1, 2, 3, 4)
    out: pathlib.Path = pathlib.Path("runs/policies")
    ship: bool = False


def main(config: PoliciesConfig) -> None:
    """Trains what is missing, the first seed of everything first."""
    runs = [options for seed in config.seeds for options in _options(config, seed)]
    cached_runs.share(functools.partial(_finish, config, options) for options in runs)


def _finish(config: PoliciesConfig, options: high_config.HighConfig) -> None:
    """Trains a run to its end, and ships it where that is asked for."""
    cached_runs.finish(options, high.train)
    if config.ship:
        with folders.locked(options.run):  # where several processes share the runs
            ship(options.run)


def _options(config: PoliciesConfig, seed: int) -> list[high_config.HighConfig]:
    """Lists the options of all runs with one seed."""
    runs = []
    kinds = itertools.product(config.presets, config.rewards, config.mazes)
    for name, reward, maze in kinds:
        # The name is what the report looks for.
        run = config.out / cached_runs.name(name, maze, reward, seed)
        task = {"task.reward": reward, "task.maze": maze}
        runs.append(
            changes.apply(presets.HIGH[name], {**task, "seed": seed, "run": run, "resume": True})
        )
    return runs


def ship(run: pathlib.Path) -> None:
    """Copies the policy of a finished run, and its metrics, into the package."""
    target = policies.PRETRAINED / run.name
    # Nothing of an earlier policy may be left beside the new one.
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(run / policies.FOLDER, target / "high")
    shutil.copy(run / "metrics.csv", target / "high_metrics.csv")
