"""Trains baselines at equal budgets: `python -m experiments.compare_peers --out runs/peers`."""

import dataclasses
import itertools
import pathlib
from typing import Literal

from eihrl_jax import base, mazes, presets
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import checks
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import higl as higl_config
from eihrl_jax.training import baselines
from experiments import _cli, _runs


@dataclasses.dataclass(frozen=True, kw_only=True)
class CompareConfig:
    """Trains each baseline in each maze for the same number of control steps (Figures 5 and 6).

    Runs that the folder already holds are continued or taken as they are;
    `python -m experiments.report --peers FOLDER` draws them beside ours. Settings are the methods'
    own, but schedules that are longer than such a budget are shortened, see docs/baselines.md.

    Attributes:
      methods: of `train_baseline`.
      mazes: names of mazes.
      rewards: of the tasks.
      seeds: of the runs of each method in each task.
      num_steps: control steps of each run, all environments together.
      out: folder of the runs, named `<method>-<maze>[-dense]-<seed>`.
    """

    methods: tuple[str, ...] = ("droq", "higl", "hess")
    mazes: tuple[str, ...] = ("random", "u", "s", "spiral")
    rewards: tuple[Literal["sparse", "dense"], ...] = ("sparse", "dense")
    seeds: tuple[int, ...] = (0, 1, 2)
    num_steps: int = 100_000
    out: pathlib.Path = pathlib.Path("runs/peers")

    def __post_init__(self) -> None:
        """Checks names and ranges."""
        for name in self.methods:
            checks.one_of("methods", name, tuple(presets.BASELINES))
        for name in self.mazes:
            checks.one_of("mazes", name, mazes.NAMES)
        for reward in self.rewards:
            checks.one_of("rewards", reward, ("sparse", "dense"))
        for seed in self.seeds:
            checks.in_range("seeds", seed, 0, 2**32 - 1)
        checks.in_range("num_steps", self.num_steps, 1, 10_000_000)
        if not (self.methods and self.mazes and self.rewards and self.seeds):
            raise base.UserError("methods, mazes, rewards and seeds must name at least one each")


def main(config: CompareConfig) -> None:
    """Trains what is missing, seed by seed, so that all methods advance together."""
    runs = itertools.product(config.seeds, config.rewards, config.mazes, config.methods)
    for seed, reward, maze, method in runs:
        _runs.finish(options_of(config, method, maze, reward, seed), baselines.train)


def options_of(
    config: CompareConfig, method: str, maze: str, reward: Literal["sparse", "dense"], seed: int
) -> baselines_config.BaselineConfig:
    """Returns the options of one run."""
    return dataclasses.replace(
        _shortened(presets.BASELINES[method]),
        maze=maze,
        reward=reward,
        seed=seed,
        num_steps=config.num_steps,
        run=config.out / _runs.name(method, maze, reward, seed),
        resume=True,
    )


def _shortened(preset: baselines_config.BaselineConfig) -> baselines_config.BaselineConfig:
    """Returns a preset for budgets of some 100,000 control steps."""
    if isinstance(preset, baselines_config.FlatConfig):
        return dataclasses.replace(preset, updates_per_step=1, capacity=200_000)
    if isinstance(preset, higl_config.HiglConfig):
        return dataclasses.replace(
            preset,
            adjacency=dataclasses.replace(preset.adjacency, period=20_000),
            landmarks=dataclasses.replace(preset.landmarks, first_step=20_000),
        )
    assert isinstance(preset, hess_config.HessConfig)
    exploration = dataclasses.replace(preset.exploration, first_episode=30, potential_episode=80)
    return dataclasses.replace(
        preset,
        random_episodes=50,
        capacity=200,
        representation=dataclasses.replace(preset.representation, every=30, num_updates=10_000),
        exploration=exploration,
    )


if __name__ == "__main__":
    _cli.run(main, CompareConfig)
