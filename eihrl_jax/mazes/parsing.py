"""Turns the text of a maze into the pytree, and says by row and column what is wrong with it.

Legend: `#` wall, `.` free, `S` start candidate, `1` to `9` goal regions; candidates of which one is
drawn per episode and becomes goal 1: `D` doors, of which the others are wall, or `G` free cells,
with `*` for one that is a start candidate too. The text includes the outer ring, which holds only
walls, goal regions and doors. In messages rows and columns are counted from 1, as text editors do.
"""

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.mazes import paths
from eihrl_jax.mazes.maze import MAX_GOALS, Maze

MIN_SIZE, MAX_SIZE = 3, 2050
"""Smallest and largest number of rows and of columns, outer ring included."""

DIGITS = "123456789"

STARTS, CANDIDATES = "S*", "DG*"
"""Where an episode may start, and of what one is drawn to be goal 1."""


def parse(
    text: str,
    *,
    name: str = "maze",
    num_decisions: int | None = None,
    start_jitter: float = 0.5,
) -> Maze:
    """Reads a maze from its text.

    Blank lines around it and blanks at the ends of lines are dropped.

    Args:
      text: rows of cells, see the legend above.
      name: how messages call the maze.
      num_decisions: time limit in subgoals; None: four times the moves of a shortest tour of
        the goals in their order from the worst start and to the worst door, at least 24.
      start_jitter: half-width of the uniform offset from the start's centre, in [0, 1.5) units.

    Raises:
      base.UserError: the text is not a maze in which every start leads to every goal and door.
    """
    checks.in_range(f"{name}: start_jitter", start_jitter, 0.0, below=base.CELL / 2)
    if num_decisions is not None:
        checks.in_range(f"{name}: num_decisions", num_decisions, 1, limits.MAX_DECISIONS)

    grid = _grid(text, name)
    _check_cells(grid, name)
    _check_ways(grid, name)

    is_door = np.isin(grid, list(CANDIDATES))
    goal = np.where(np.isin(grid, list(DIGITS)), grid, "0").astype(np.int32)
    fields = {
        "wall": np.isin(grid, list("#D")),  # doors until an episode draws one of them
        "goal": goal,
        "start": np.isin(grid, list(STARTS)),
        "door": is_door,
        "start_jitter": np.float32(start_jitter),
        "num_goals": np.int32(max(goal.max(), int(is_door.any()))),
        "num_decisions": np.int32(num_decisions or 0),  # 0 until the tour is known, below
    }
    # `jnp.asarray` of each would compile a program for every shape of a maze.
    maze = Maze(**jax.device_put(fields))
    if num_decisions is None:
        maze = maze.replace(num_decisions=jnp.int32(max(24, 4 * paths.longest_tour(maze))))
    return maze


def _grid(text: str, name: str) -> np.ndarray:
    """Splits the text into one character per cell, [R, C]."""
    lines = [line.rstrip() for line in text.splitlines()]
    filled = [i for i, line in enumerate(lines) if line]
    if not filled:
        raise base.UserError(f"{name}: the text is empty")

    # Blank lines between rows stay, and are named as rows without columns.
    lines = lines[filled[0] : filled[-1] + 1]

    # Characters before lengths: a tab, say, is the likelier cause of a line that is too short.
    for i, line in enumerate(lines):
        for j, character in enumerate(line):
            if character not in "#.S*DG" + DIGITS:
                raise base.UserError(
                    f"{name}: unknown character {character!r} at {_where((i, j))}; "
                    "known are # . S D G * and 1 to 9"
                )
        if len(line) != len(lines[0]):
            raise base.UserError(
                f"{name}: row {i + 1} has {len(line)} columns, but row 1 has {len(lines[0])}"
            )
    for what, size in (("rows", len(lines)), ("columns", len(lines[0]))):
        checks.in_range(f"{name}: number of {what}", size, MIN_SIZE, MAX_SIZE)
    return np.array([list(line) for line in lines])


def _check_cells(grid: np.ndarray, name: str) -> None:
    """Checks that starts and goals are there, numbered without gaps, and the ring is closed."""
    ring = np.ones(grid.shape, bool)
    ring[1:-1, 1:-1] = False
    for cell in paths.cells(ring & np.isin(grid, list(".SG*"))):
        raise base.UserError(
            f"{name}: {str(grid[cell])!r} at {_where(cell)} leaves the outer ring open; "
            "only # D and 1 to 9 may be there"
        )

    starts = paths.cells(np.isin(grid, list(STARTS)))
    if not starts:
        raise base.UserError(f"{name}: no start; mark at least one cell with S")
    if len(starts) == 1 and grid[starts[0]] == "*":
        raise base.UserError(
            f"{name}: the only start, at {_where(starts[0])}, may be the goal; mark another one"
        )

    has_door = bool(np.isin(grid, list(CANDIDATES)).any())
    present = [int(digit) for digit in DIGITS if (grid == digit).any()]
    if not present and not has_door:
        raise base.UserError(f"{name}: no goal; mark a region with 1 or candidates with D or G")

    doors, free = paths.cells(grid == "D"), paths.cells(np.isin(grid, list("G*")))
    if doors and free:
        raise base.UserError(
            f"{name}: door candidate at {_where(doors[0])} beside the free one at "
            f"{_where(free[0])}; candidates are all D, or all G and *"
        )
    # The open door is goal 1, so regions are numbered on from there.
    if has_door and 1 in present:
        raise base.UserError(
            f"{name}: goal 1 at {_where(paths.cells(grid == '1')[0])} beside door candidates; "
            "the open door is goal 1, so regions are numbered from 2"
        )
    # The first number that isn't the next one is named; there may be more of them behind it.
    for number, expected in zip(present, range(2 if has_door else 1, MAX_GOALS + 1), strict=False):
        if number != expected:
            where = _where(paths.cells(grid == str(number))[0])
            raise base.UserError(f"{name}: goal {number} at {where}, but there is no {expected}")


def _check_ways(grid: np.ndarray, name: str) -> None:
    """Checks that every start leads to every goal and door without passing another door."""
    first = paths.cells(np.isin(grid, list(STARTS)))[0]
    no_way = f"{name}: no way from the start at {_where(first)} to"
    # What the first start reaches, the others reach by way of it.
    reached = paths.distances((grid != "#") & (grid != "D"), [first])

    unreached = reached < 0
    for start in paths.cells(unreached & np.isin(grid, list(STARTS))):
        raise base.UserError(f"{no_way} the start at {_where(start)}")
    for goal in paths.cells(unreached & np.isin(grid, list(DIGITS + "G"))):
        label = "the candidate" if grid[goal] == "G" else f"goal {grid[goal]}"
        raise base.UserError(f"{no_way} {label} at {_where(goal)}")
    for door in paths.cells(grid == "D"):
        if paths.way_to_door(reached, door) < 0:
            raise base.UserError(f"{no_way} the door candidate at {_where(door)}")


def _where(cell: paths.Cell) -> str:
    """Returns where a cell is in the words of a text editor, which counts from 1."""
    return f"row {cell[0] + 1}, column {cell[1] + 1}"
