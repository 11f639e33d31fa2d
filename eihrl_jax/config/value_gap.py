"""Options of comparing bounds on the hierarchy's loss with the loss that is measured."""

import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import limits

_SIGMAS = (0.0, 0.1, 0.2, 0.28, 0.29, 0.31, 0.32, 0.4, 0.5, 0.6, 0.8, 1.0)
"""Densest around the reference of 0.3, where the bounds say something."""


@limits.dataclass
class ValueGapConfig:
    """Measures how a high level's value changes with the robot's noise, and what bounds say.

    A trained high level acts in mazes with oracle movement at one noise level after another, then
    in the full hierarchy with shipped low levels. Each value is compared with that under the noise
    with which it was trained; beside it stands the corrected bound. Writes gap.json, gap.md and
    gap.png.

    Attributes:
      high: the high level: run folder, policy folder or shipped name.
      mazes: names or text files, with one goal each.
      sigmas: noise levels of oracle movement: standard deviation per axis, units.
      reference: noise level that the others are compared with, units.
      robots: robots of the full hierarchy, with their shipped low levels.
      episodes: of the oracle, per maze and noise level.
      full_episodes: of the full hierarchy, per maze and robot.
      gamma: discount per decision; the high level's preset `best` has 0.94.
      seed: of the random numbers.
      out: folder of the results; must be new or empty.
    """

    high: str = "best-random-0"
    mazes: limits.Several[str] = ("random", "g1")
    sigmas: tuple[Annotated[float, limits.Range(0.0, base.CELL)], ...] = _SIGMAS
    reference: Annotated[float, limits.Range(above=0.0, high=base.CELL)] = base.SIGMA
    robots: tuple[str, ...] = ("point", "ant")
    episodes: Annotated[int, limits.Range(2, 1_000_000)] = 2_000
    full_episodes: Annotated[int, limits.Range(2, 1_000_000)] = 500  # each costs its physics
    gamma: Annotated[float, limits.Range(0.0, below=1.0)] = 0.94
    seed: limits.Seed = 0
    out: pathlib.Path = pathlib.Path("runs/value-gap")
