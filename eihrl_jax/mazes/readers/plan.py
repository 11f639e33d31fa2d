"""The result of every reader: a grid in our legend, and how the file's places map to it."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from eihrl_jax import base
from eihrl_jax.config import reading
from eihrl_jax.mazes import parsing, paths


@dataclasses.dataclass(frozen=True)
class Plan:
    """A maze as its file has it.

    Attributes:
      kind: what the file is, e.g. "JaxUED level".
      grid: [R, C] characters of the legend of `parsing`, outer ring included.
      first: cell of the grid at which row 1, column 1 of the file lies.
      num_decisions: time limit of this kind of file; None: it has none.
      head: what stands above the rows of our own files.
      from_metres: row and column on the grid, fractions counted from 0, of x and y in metres; None
        where the file knows no metres.
    """

    kind: str
    grid: np.ndarray
    first: paths.Cell = (0, 0)
    num_decisions: int | None = None
    head: Mapping[str, str] = dataclasses.field(default_factory=dict)
    from_metres: Callable[[float, float], tuple[float, float]] | None = None

    @property
    def text(self) -> str:
        """The grid as `parsing.parse` takes it."""
        head = (f"{word} {value}" for word, value in self.head.items())
        return "\n".join([*head, *("".join(row) for row in self.grid)])

    def with_places(self, options: reading.ReadingConfig, name: str) -> "Plan":
        """Returns the plan with the options' start and goal in place of the file's.

        Raises:
          base.UserError: one of them is in a wall, outside, or the only start.
        """
        grid = self.grid.copy()
        for what, place, mark in (("start", options.start, "S"), ("goal", options.goal, "1")):
            if place is None:
                continue
            _wipe(grid, what)
            cell = self._cell(place, options, f"{name}: {what}")
            if grid[cell] in ("#", "D"):
                raise base.UserError(f"{name}: {what} = {_shown(place)} is in a wall")
            # Where starts are many, one of them may become the goal.
            if grid[cell] == "S" and (grid == "S").sum() == 1:
                raise base.UserError(f"{name}: {what} = {_shown(place)} is the start")
            grid[cell] = mark
        return dataclasses.replace(self, grid=grid)

    def _cell(self, place: reading.Place, options: reading.ReadingConfig, what: str) -> paths.Cell:
        """Returns the cell of a place that the options name."""
        if options.places == "metres":
            if self.from_metres is None:
                raise base.UserError(f"{what}: a {self.kind} knows no metres; name row and column")
            row, column = self.from_metres(*place)
        else:
            row, column = (place[i] - 1 + self.first[i] for i in range(2))

        rows, columns = self.grid.shape
        if not (0 <= row < rows and 0 <= column < columns):  # also of NaN
            raise base.UserError(f"{what} = {_shown(place)} is outside the maze")
        return math.floor(row), math.floor(column)


def _shown(place: reading.Place) -> str:
    return f"{place[0]:g} {place[1]:g}"


def _wipe(grid: np.ndarray, what: str) -> None:
    """Removes the file's own starts or goals from a grid, in place."""
    swaps = {"S": ".", "*": "G"} if what == "start" else {"G": ".", "*": "S", "D": "#"}
    if what == "goal":
        swaps |= dict.fromkeys(parsing.DIGITS, ".")
    for old, new in swaps.items():
        grid[grid == old] = new


def of_free(
    kind: str,
    free: Bool[np.ndarray, "R C"],
    *,
    starts: Iterable[paths.Cell] = (),
    goals: Sequence[paths.Cell] = (),
    always_ringed: bool = False,
    num_decisions: int | None = None,
    name: str,
) -> Plan:
    """Returns the plan of a grid of free cells, within a ring of wall if it has none.

    Args:
      kind: what the file is.
      free: cells that can be entered.
      starts: cells of the file where episodes start.
      goals: one goal, or candidates of which one is drawn.
      always_ringed: whether the file never holds the outer wall; else a closed border is it.
      num_decisions: time limit that belongs to the kind of file.
      name: how messages call the maze.

    Raises:
      base.UserError: a start or goal is a wall or outside; or the grid is too large.
    """
    for size in free.shape:
        if not 1 <= size <= parsing.MAX_SIZE:
            raise base.UserError(
                f"{name}: {free.shape[0]} x {free.shape[1]} cells, must be at least 1 x 1 and at "
                f"most {parsing.MAX_SIZE} x {parsing.MAX_SIZE}"
            )
    grid = np.where(free, ".", "#")
    goal_mark = "G" if len(goals) > 1 else "1"
    for what, places, mark in (("goal", goals, goal_mark), ("start", starts, "S")):
        for i, j in places:
            where = f"row {i + 1}, column {j + 1}"
            if not (0 <= i < free.shape[0] and 0 <= j < free.shape[1]):
                raise base.UserError(f"{name}: {what} at {where} is outside the maze")
            if not free[i, j]:
                raise base.UserError(f"{name}: {what} at {where} is in a wall")
            if mark == "S" and grid[i, j] == "1":
                raise base.UserError(f"{name}: start and goal are both at {where}")
            grid[i, j] = "*" if mark == "S" and grid[i, j] == "G" else mark

    border = np.concatenate([free[0], free[-1], free[:, 0], free[:, -1]])
    if not (always_ringed or border.any() or min(free.shape) < parsing.MIN_SIZE):
        return Plan(kind, grid, num_decisions=num_decisions)
    ringed = np.pad(grid, 1, constant_values="#")
    return Plan(kind, ringed, first=(1, 1), num_decisions=num_decisions)


def solver_limit(shape: tuple[int, ...]) -> int:
    """Returns the time limit of minimax's and JaxUED's mazes, 2 (H + 2) (W + 2).

    Args:
      shape: H and W, without the outer wall.

    Source: minimax, `maze_ood.py`.

    >>> solver_limit((13, 13)), solver_limit((101, 101))
    (450, 21218)
    """
    return 2 * (shape[0] + 2) * (shape[1] + 2)
