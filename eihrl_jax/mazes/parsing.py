"""Parses the text of a maze; errors name row and column.

Legend: `#` wall, `.` free, `S` start candidate, `1` to `9` goal regions; candidates of which one is
drawn per episode and becomes goal 1: `D` doors, of which the others are wall, or `G` free cells,
with `*` for one that is a start candidate too. The text includes the outer ring, which holds only
walls, goal regions and doors. Above it may stand `decisions 450`, the time limit in subgoals, and
`jitter 0.5`, see `parse`. In messages rows and columns are counted from 1, as text editors do.
"""

import re

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.mazes import paths
from eihrl_jax.mazes.maze import MAX_GOALS, Maze

MIN_SIZE, MAX_SIZE = 3, 2050
"""Smallest and largest number of rows and of columns, outer ring included."""

MIN_DECISIONS = 24
"""Smallest default time limit (the smallest of the paper's Table 3, divided by 25)."""

START_JITTER = 0.5
"""Default half-width of the offset from a start's centre, units."""

DIGITS = "123456789"

STARTS, CANDIDATES = "S*", "DG*"
"""Characters of start candidates, and of candidates for goal 1."""

_HEAD = re.compile(r"(decisions|jitter) +(\S+)")


def parse(
    text: str,
    *,
    name: str = "maze",
    num_decisions: int | None = None,
    start_jitter: float | None = None,
    first: paths.Cell = (0, 0),
    on_host: bool = False,
) -> Maze:
    """Reads a maze from its text.

    Blank lines around it and blanks at the ends of lines are dropped.

    Args:
      text: rows of cells, see the legend above.
      name: how messages call the maze.
      num_decisions: time limit in subgoals; None: the text's own, else see `default_limit`.
      start_jitter: half-width of the uniform offset from the start's centre, in [0, 1.5) units;
        None: the text's own, else 0.5.
      first: row and column of the text that messages call row 1, column 1.
      on_host: leave the maze's arrays to NumPy, which starts no device of JAX.

    Raises:
      base.UserError: the text is not a maze in which every start leads to every goal and door.
    """
    head, grid = read_grid(text, name)
    if start_jitter is None:
        start_jitter = _number(name, "jitter", head) if "jitter" in head else START_JITTER
    checks.in_range(f"{name}: start_jitter", start_jitter, 0.0, below=base.CELL / 2)
    if num_decisions is None and "decisions" in head:
        num_decisions = int(_number(name, "decisions", head))
    if num_decisions is not None:
        checks.in_range(f"{name}: num_decisions", num_decisions, 1, limits.MAX_DECISIONS)

    _check_cells(grid, name, first)
    _check_ways(grid, name, first)

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
    maze = Maze(**fields)
    if num_decisions is None:
        maze = maze.replace(num_decisions=default_limit(maze))
    # `jnp.asarray` of each would compile a program for every shape of a maze.
    return maze if on_host else jax.device_put(maze)


def default_limit(maze: Maze) -> np.int32:
    """Returns the default time limit of a maze, int32, in subgoals.

    Four times the moves of a shortest tour of the goals in their order from the worst start and to
    the worst candidate, at least 24.
    """
    return np.int32(max(MIN_DECISIONS, 4 * paths.longest_tour(maze)))


def text_of(maze: Maze) -> str:
    """Writes a maze as `parse` reads it, with head lines for values that aren't the default."""
    wall, door, start = (np.asarray(mask) for mask in (maze.wall, maze.door, maze.start))
    goal = np.asarray(maze.goal)
    kinds = [wall & door, wall, door & start, door, start, goal > 0]
    grid = np.select(kinds, ["D", "#", "*", "G", "S", goal.astype("U1")], default=".")

    head = []
    if maze.num_decisions != default_limit(maze):
        head.append(f"decisions {int(maze.num_decisions)}\n")
    # The shortest text that is the same number in float32.
    if maze.start_jitter != START_JITTER:
        head.append(f"jitter {np.asarray(maze.start_jitter)[()]}\n")
    return "".join(head) + "".join("".join(row) + "\n" for row in grid)


def read_grid(text: str, name: str) -> tuple[dict[str, str], np.ndarray]:
    """Splits a text into its head lines, word by word, and one character per cell, [R, C].

    Raises:
      base.UserError: an unknown character, rows of different lengths, or a grid out of its limits.
    """
    # All line ends that editors write, but not those that only Unicode defines.
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    head, lines = _split_head([line.rstrip(" \t") for line in lines])
    return head, _grid(lines, name)


def _split_head(lines: list[str]) -> tuple[dict[str, str], list[str]]:
    """Splits the head lines from the rows."""
    head: dict[str, str] = {}
    for i, line in enumerate(lines):
        found = _HEAD.fullmatch(line)
        if line and not found:
            return head, lines[i:]
        if found:
            head[found[1]] = found[2]
    return head, []


def _number(name: str, word: str, head: dict[str, str]) -> float:
    """Reads the number of a head line."""
    try:
        return int(head[word]) if word == "decisions" else float(head[word])
    except ValueError:
        kind = "a whole number" if word == "decisions" else "a number"
        raise base.UserError(f"{name}: {word} {head[word]!r} is not {kind}") from None


def _grid(lines: list[str], name: str) -> np.ndarray:
    """Turns lines into one character per cell, [R, C]."""
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
        check_length(len(line), i, len(lines[0]), name)
    for what, size in (("rows", len(lines)), ("columns", len(lines[0]))):
        checks.in_range(f"{name}: number of {what}", size, MIN_SIZE, MAX_SIZE)
    return np.array([list(line) for line in lines])


def check_length(length: int, row: int, expected: int, name: str) -> None:
    """Checks that a row, counted from 0, is as long as the first one.

    Raises:
      base.UserError: it isn't.
    """
    if length != expected:
        raise base.UserError(
            f"{name}: row {row + 1} has {length} columns, but row 1 has {expected}"
        )


def _check_cells(grid: np.ndarray, name: str, first: paths.Cell) -> None:
    """Checks that starts and goals are there, numbered without gaps, and the ring is closed."""
    ring = np.ones(grid.shape, bool)
    ring[1:-1, 1:-1] = False
    for cell in paths.cells(ring & np.isin(grid, list(".SG*"))):
        raise base.UserError(
            f"{name}: {str(grid[cell])!r} at {_where(cell, first)} leaves the outer ring open; "
            "only # D and 1 to 9 may be there"
        )

    starts = paths.cells(np.isin(grid, list(STARTS)))
    if not starts:
        raise base.UserError(f"{name}: no start; mark at least one cell with S")
    if len(starts) == 1 and grid[starts[0]] == "*":
        raise base.UserError(
            f"{name}: the only start, at {_where(starts[0], first)}, may be the goal; "
            "mark another one"
        )

    has_door = bool(np.isin(grid, list(CANDIDATES)).any())
    present = [int(digit) for digit in DIGITS if (grid == digit).any()]
    if not present and not has_door:
        raise base.UserError(f"{name}: no goal; mark a region with 1 or candidates with D or G")

    doors, free = paths.cells(grid == "D"), paths.cells(np.isin(grid, list("G*")))
    if doors and free:
        raise base.UserError(
            f"{name}: door candidate at {_where(doors[0], first)} beside the free one at "
            f"{_where(free[0], first)}; candidates are all D, or all G and *"
        )
    # The open door is goal 1, so regions are numbered on from there.
    if has_door and 1 in present:
        raise base.UserError(
            f"{name}: goal 1 at {_where(paths.cells(grid == '1')[0], first)} beside door "
            "candidates; the open door is goal 1, so regions are numbered from 2"
        )
    # The first gap is named; there may be more.
    for number, expected in zip(present, range(2 if has_door else 1, MAX_GOALS + 1), strict=False):
        if number != expected:
            where = _where(paths.cells(grid == str(number))[0], first)
            raise base.UserError(f"{name}: goal {number} at {where}, but there is no {expected}")


def _check_ways(grid: np.ndarray, name: str, first: paths.Cell) -> None:
    """Checks that every start leads to every goal and door without passing another door."""
    starts = np.isin(grid, list(STARTS))
    source = paths.cells(starts)[0]
    # One start is enough: all starts must be connected with it.
    reached = paths.distances(~np.isin(grid, ["#", "D"]), [source])
    reached = paths.with_doors(reached, grid == "D")

    kinds = {
        "the start": starts,
        "goal": np.isin(grid, list(DIGITS)),
        "the candidate": grid == "G",
        "the door candidate": grid == "D",
    }
    for kind, mask in kinds.items():
        for cell in paths.cells(mask & (reached < 0))[:1]:
            what = f"goal {grid[cell]}" if kind == "goal" else kind
            raise base.UserError(
                f"{name}: no way from the start at {_where(source, first)} to {what} at "
                f"{_where(cell, first)}"
            )


def _where(cell: paths.Cell, first: paths.Cell = (0, 0)) -> str:
    """Describes a cell by row and column, counted from 1 as in text editors."""
    return f"row {cell[0] - first[0] + 1}, column {cell[1] - first[1] + 1}"
