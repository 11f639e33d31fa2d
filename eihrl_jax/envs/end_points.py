"""The law of a robot's end points: where its subgoals ended, one row for each that was measured.

Where a subgoal ends hangs on how the robot comes into it: straight on, out of a turn, out of
standing still, or lying on the ground. So each row also says that.
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
"""How a subgoal began: where it points, seen from the one before; after standing still, as an
episode does; or on the ground, which counts as `rest` for the next one once the robot stands."""

AHEAD, LEFT, BEHIND, RIGHT, REST, DOWN = range(len(CONDITIONS))

_QUARTERS = (0, 2, 1, 3)
"""Quarter turns to the left from x+, in the order of `base.DIRECTIONS_XY`."""


@dataclasses.dataclass(frozen=True)
class EndPoints:
    """Ends of S subgoals that no wall was in the way of.

    Attributes:
      condition: int [S], how each began, an index of `CONDITIONS`.
      along: float [S], displacement along the subgoal from where it counted, units.
      lateral: float [S], the same to its left.
      is_down: bool [S], whether the robot lay on the ground at its end.
    """

    condition: Int[np.ndarray, " S"]
    along: Float[np.ndarray, " S"]
    lateral: Float[np.ndarray, " S"]
    is_down: Bool[np.ndarray, " S"]


def turns() -> Int[np.ndarray, "4 4"]:
    """Returns the condition under which the second direction of two begins, by both."""
    quarters = np.array(_QUARTERS)
    return (quarters[None] - quarters[:, None]) % base.NUM_DIRECTIONS


def save(path: pathlib.Path, robot: str, anchored: EndPoints, free: EndPoints) -> None:
    """Writes a robot's end points of anchored subgoals, and of those that count from its torso."""
    tables = {"anchored": _table(anchored), "free": _table(free)}
    archives.write(path, {"robot": np.array(robot), **tables})


def _table(ends: EndPoints) -> Float[np.ndarray, "S 4"]:
    """Returns end points as numbers: two millimetres at three metres, finer than they are known."""
    columns = ends.condition, ends.along, ends.lateral, ends.is_down
    return np.stack(columns, 1).astype(np.float16)


def load(path: pathlib.Path, robot: str, *, anchored: bool) -> EndPoints:
    """Reads end points.

    Args:
      path: of a file that `save` has written.
      robot: name of the robot whose they must be.
      anchored: whether those of anchored subgoals are wanted.

    Raises:
      base.UserError: there is no such file, it is damaged or another robot's, or it has none.
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
        raise base.UserError(f"end points {path} tell of subgoals that begin in no known way")
    return EndPoints(condition.astype(np.int64), along, lateral, is_down > 0.0)


def shipped(robot: str) -> pathlib.Path:
    """Returns where the package holds those of a robot's low level, if it has one."""
    return base.PRETRAINED / robot / FILE
