"""A robot's measured end points: where its subgoals ended, one row per subgoal.

The end point depends on how the subgoal began: straight on, after a turn, from standing still, or
from the ground. So each row also has this condition.
"""

import dataclasses
import pathlib

import numpy as np
from jaxtyping import Bool, Float, Int

from eihrl_jax import base
from eihrl_jax.storage import archives

FILE = "ends.npz"
"""Name of the file in which a measurement keeps its end points."""

CONDITIONS = ("ahead", "left", "behind", "right", "rest", "down")
"""How a subgoal began: its direction relative to the previous one; from standing still (`rest`), as
in an episode's first decision and after getting up; or from the ground (`down`)."""

AHEAD, LEFT, BEHIND, RIGHT, REST, DOWN = range(len(CONDITIONS))

_QUARTERS = (0, 2, 1, 3)
"""Quarter turns to the left from x+, in the order of `base.DIRECTIONS_XY`."""


@dataclasses.dataclass(frozen=True)
class EndPoints:
    """End points of S subgoals without a wall in the way.

    Attributes:
      condition: int [S], how each began, an index of `CONDITIONS`.
      along: float [S], displacement along the subgoal from its origin (the torso, or for anchored
        subgoals `task.anchor`), units.
      lateral: float [S], displacement to the subgoal's left, units.
      is_down: bool [S], whether the robot lay on the ground at its end.
    """

    condition: Int[np.ndarray, " S"]
    along: Float[np.ndarray, " S"]
    lateral: Float[np.ndarray, " S"]
    is_down: Bool[np.ndarray, " S"]


def turns() -> Int[np.ndarray, "4 4"]:
    """Returns the condition of a direction (second axis) after another one (first axis)."""
    quarters = np.array(_QUARTERS)
    return (quarters[None] - quarters[:, None]) % base.NUM_DIRECTIONS


def save(path: pathlib.Path, robot: str, anchored: EndPoints, free: EndPoints) -> None:
    """Writes a robot's end points of anchored subgoals, and of free ones."""
    tables = {"anchored": _table(anchored), "free": _table(free)}
    archives.write(path, {"robot": np.array(robot), **tables})


def _table(ends: EndPoints) -> Float[np.ndarray, "S 4"]:
    """Returns end points as float16: precise to 2 mm at 3 m, finer than they are measured."""
    columns = ends.condition, ends.along, ends.lateral, ends.is_down
    return np.stack(columns, 1).astype(np.float16)


def load(path: pathlib.Path, robot: str, *, anchored: bool) -> EndPoints:
    """Reads end points.

    Args:
      path: of a file that `save` has written.
      robot: name of the robot whose they must be.
      anchored: whether those of anchored subgoals are wanted.

    Raises:
      base.UserError: the file doesn't exist, is damaged, is of another robot, or holds no such end
        points.
    """
    kind = "anchored" if anchored else "free"
    try:
        arrays = archives.read(path)
        name, table = str(arrays["robot"]), arrays[kind].astype(np.float64)
    except (OSError, ValueError, KeyError) as error:
        raise base.UserError(f"end points {path} can't be read: {error}") from None

    if name != robot:
        raise base.UserError(f"end points {path} are of robot {name!r}, expected {robot!r}")
    if table.ndim != 2 or table.shape[1] != 4 or not len(table) or not np.isfinite(table).all():
        raise base.UserError(f"end points {path} hold no {kind} subgoals, or not whole ones")
    condition, along, lateral, is_down = table.T
    if not np.isin(condition, range(len(CONDITIONS))).all():
        raise base.UserError(
            f"end points {path} have a condition that isn't in 0 to {len(CONDITIONS) - 1}"
        )
    return EndPoints(condition.astype(np.int64), along, lateral, is_down > 0.0)


def shipped(robot: str) -> pathlib.Path:
    """Returns the path of the end points that the package ships for a robot, if it does."""
    return base.PRETRAINED / robot / FILE
