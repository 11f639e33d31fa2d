"""Subgoal statistics: how accurately a low level follows subgoals (paper, Definition 3.1)."""

import dataclasses
import math
import pathlib
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from eihrl_jax import base
from eihrl_jax.envs import postures
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.storage import reading

FILE, POSTURES = "subgoals.json", "postures.npz"
"""Names of the files in which a measurement keeps its figures and its posture bank."""

OPEN, ROOMS, CORRIDORS = "open floor", "random rooms", "corridors"
"""Surroundings in which low levels are measured. In corridors, one cell wide, subgoals are anchored
and only directions without a wall ahead are drawn."""

DRIFT = "drift"
"""Key of the list of `Drift` in a measurement's figures."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statistics:
    """How accurately a robot follows random subgoals in one kind of surroundings.

    Attributes:
      num_subgoals: number of subgoals begun upright.
      blocked: share of them with a wall in the way, which the displacements leave out.
      along_mean: displacement along the subgoal, units.
      along_std: its standard deviation, units.
      lateral_mean: displacement to the left of the subgoal, the bias, units.
      lateral_std: its standard deviation, units.
      correlation: between the two.
      along_distance: Wasserstein-1 distance between the law of `along` minus one cell and the
        normal law that the high level trains with, units.
      lateral_distance: the same of `lateral`.
      falls: per 1,000 subgoals begun upright.
      recovered: share of the falls after which the robot stood again; NaN without falls.
      recovery_seconds: median time until then; NaN without recoveries.
      breakdowns: unstable simulations per 1,000 subgoals.
      falls_straight: falls per 1,000 subgoals in the direction of the one before; NaN without any.
      falls_quarter: of those to its left or right.
      falls_half: of those back where it came from.
    """

    num_subgoals: int
    blocked: float
    along_mean: float
    along_std: float
    lateral_mean: float
    lateral_std: float
    correlation: float
    along_distance: float
    lateral_distance: float
    falls: float
    recovered: float
    recovery_seconds: float
    breakdowns: float
    falls_straight: float = math.nan
    falls_quarter: float = math.nan
    falls_half: float = math.nan

    @property
    def sigma(self) -> float:
        """Standard deviation per axis, both axes taken together, units."""
        return math.sqrt((self.along_std**2 + self.lateral_std**2) / 2.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drift:
    """Offsets of robots from the centres of their cells after several subgoals on open floor.

    Attributes:
      anchored: whether their subgoals were, see `task.anchor`.
      num_subgoals: how many followed each other, in random directions.
      num_robots: how many of the robots never fell.
      along_mean: from the centre of the robot's own cell, along its last subgoal; mean over these
        robots, units.
      along_std: its standard deviation, units.
      lateral_mean: the same to the left of the last subgoal.
      lateral_std: its standard deviation, units.
      in_cell: share of these robots whose cell is the one that the subgoals lead to.
    """

    anchored: bool
    num_subgoals: int
    num_robots: int
    along_mean: float
    along_std: float
    lateral_mean: float
    lateral_std: float
    in_cell: float


def load(folder: pathlib.Path) -> Statistics:
    """Reads the figures for open floor from the folder of a measurement.

    Raises:
      base.UserError: there are none, or they are damaged.
    """
    path = folder / FILE

    # Field by field: a file with one too many or too few is damaged.
    try:
        statistics = Statistics(**reading.read_json(path)[OPEN])
        is_known = math.isfinite(statistics.along_mean) and math.isfinite(statistics.sigma)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise base.UserError(f"measurement {path} can't be read: {error}") from None
    if not is_known:
        raise base.UserError(f"measurement {path} holds no displacement: no subgoal was completed")
    return statistics


class Gait(NamedTuple):
    """How a robot carries out subgoals, as oracle movement imitates it.

    Attributes:
      step: units per subgoal.
      sigma: standard deviation per axis, units.
      bank: postures that are shown.
    """

    step: float
    sigma: float
    bank: postures.PostureBank


def gait(robot: robot_lib.Robot, measured: pathlib.Path | None, step: float, sigma: float) -> Gait:
    """Returns the gait that was measured of a robot, or else `step` and `sigma` as they are given.

    Args:
      robot: the robot.
      measured: folder of a measurement; None: none, and the postures are those of
        `postures.for_robot`.
      step: units per subgoal, without a measurement.
      sigma: standard deviation per axis without a measurement, units.

    Raises:
      base.UserError: the measurement can't be read, or is another robot's.
    """
    if measured is None:
        return Gait(step, sigma, postures.for_robot(robot))
    # Step, sigma and postures are those of one and the same gait.
    statistics = load(measured)
    bank = postures.load(measured / POSTURES, robot)
    return Gait(statistics.along_mean, statistics.sigma, bank)


def summarise(metrics: dict[str, Float[Array, "T N"]]) -> dict[str, Float[Array, ""]]:
    """Summarises the metrics of `envs.locomotion.Locomotion` over T steps of N robots.

    Args:
      metrics: `switched`, `along`, `lateral`, `upright`, `fell`, `broke_down`, each [T, N].

    Returns:
      `along_mean`, `along_std`, `lateral_mean` (bias), `lateral_std` of the displacement per
      completed subgoal, in units, in the frame of its direction; `falls` and `breakdowns` per 1,000
      subgoals, where one that ended in a fall counts as begun; `upright`, how upright the robots
      are when a subgoal ends; `num_subgoals`. NaN where no subgoal was completed.
    """
    switched = metrics["switched"]
    along_mean, along_std = _moments(metrics["along"], switched)
    lateral_mean, lateral_std = _moments(metrics["lateral"], switched)
    upright, _ = _moments(metrics["upright"], switched)

    # A fall or a breakdown ends the episode, and with it a subgoal that is never completed.
    falls, breakdowns = metrics["fell"].sum(), metrics["broke_down"].sum()
    begun = jnp.maximum(switched.sum() + falls + breakdowns, 1.0)
    return {
        "along_mean": along_mean,
        "along_std": along_std,
        "lateral_mean": lateral_mean,
        "lateral_std": lateral_std,
        "upright": upright,
        "falls": 1000.0 * falls / begun,
        "breakdowns": 1000.0 * breakdowns / begun,
        "num_subgoals": begun,
    }


def _moments(
    values: Float[Array, "T N"], weights: Float[Array, "T N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns mean and standard deviation of the values whose weight is 1."""
    # Weighted, since the shape can't depend on how many subgoals were completed.
    mean = jnp.sum(weights * values) / weights.sum()
    return mean, jnp.sqrt(jnp.sum(weights * jnp.square(values - mean)) / weights.sum())
