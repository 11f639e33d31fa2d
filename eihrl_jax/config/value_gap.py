"""Options of comparing bounds on the hierarchy's loss with the loss that is measured."""

import dataclasses
import pathlib

from eihrl_jax import base
from eihrl_jax.config import checks


@dataclasses.dataclass(frozen=True, kw_only=True)
class ValueGapConfig:
    """Measures how a high level's value changes with the robot's noise, and what bounds say.

    A trained high level is moved through mazes by the oracle with one noise level after another,
    and walks in them with shipped low levels. Each value is compared with that under the noise
    with which it was trained; beside it stands the corrected bound. Writes gap.json, gap.md and
    gap.png.

    Attributes:
      high: the high level: run folder, policy folder or shipped name.
      mazes: names or text files, with one goal each.
      sigmas: noise levels of oracle movement: standard deviation per axis, units.
      reference: noise level that the others are compared with, units.
      robots: robots with shipped low levels, which walk.
      episodes: of the oracle, per maze and noise level.
      walking_episodes: per maze and walking robot.
      gamma: discount per decision; the high level's preset `best` has 0.94.
      seed: of the random numbers.
      out: folder of the results; must be new or empty.
    """

    high: str = "best-random-0"
    mazes: tuple[str, ...] = ("random", "g1")
    sigmas: tuple[float, ...] = (0.0, 0.1, 0.2, 0.28, 0.29, 0.31, 0.32, 0.4, 0.5, 0.6, 0.8, 1.0)
    reference: float = base.SIGMA
    robots: tuple[str, ...] = ("point", "ant")
    episodes: int = 2_000
    walking_episodes: int = 500
    gamma: float = 0.94
    seed: int = 0
    out: pathlib.Path = pathlib.Path("runs/value-gap")

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.distinct("mazes", self.mazes)
        for sigma in self.sigmas:
            checks.in_range("sigmas", sigma, 0.0, base.CELL)
        checks.in_range("reference", self.reference, above=0.0, high=base.CELL)
        checks.in_range("episodes", self.episodes, 2, 1_000_000)
        checks.in_range("walking_episodes", self.walking_episodes, 2, 1_000_000)
        checks.in_range("gamma", self.gamma, 0.0, below=1.0)
        checks.in_range("seed", self.seed, 0, 2**32 - 1)
