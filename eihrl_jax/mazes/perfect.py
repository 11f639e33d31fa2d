"""Perfect mazes of any size: one way between any two places, walls and ways of one cell's width."""

import numpy as np
from jaxtyping import Bool

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.mazes import parsing, paths

MAX_INSIDE = parsing.MAX_SIZE - 3
"""Largest number of rows or columns inside the outer ring; it is odd."""


def perfect_maze(seed: int, rows: int, columns: int, *, loops: float = 0.0) -> str:
    """Draws the text of a perfect maze; the same arguments give the same maze.

    Args:
      seed: of the maze, at least 0.
      rows: number of rows inside the outer ring; odd, at least 3.
      columns: number of columns inside the outer ring; odd, at least 3.
      loops: share of the inner cells that are opened afterwards, 0 to 1: the maze is no longer
        perfect, its ways meet again.

    Returns:
      A text for `parsing.parse`, start and goal drawn from all free cells.

    Raises:
      base.UserError: an argument out of its limits.

    Source: randomised depth-first search, the distribution of `PerfectMaze` of minimax (Jiang et
      al. 2023).

    >>> print(perfect_maze(1, 5, 5))  # doctest: +ELLIPSIS
    #######
    ...
    """
    checks.in_range("seed", seed, 0)
    checks.in_range("loops", loops, 0.0, 1.0)
    for name, side in (("rows", rows), ("columns", columns)):
        checks.in_range(name, side, 3, MAX_INSIDE)
        if side % 2 == 0:
            raise base.UserError(f"{name} = {side} must be odd")

    rng = np.random.default_rng(seed)
    grid = np.full((rows + 2, columns + 2), "#")
    first = int(rng.integers(rows // 2 + 1)), int(rng.integers(columns // 2 + 1))
    grid[ways(rng, rows, columns, first)] = "."
    if loops:
        grid[1:-1, 1:-1][rng.random((rows, columns)) < loops] = "."

    # The goal first, then the start among the other cells.
    free = paths.cells(grid == ".")
    goal, start = rng.choice(len(free), 2, replace=False)
    grid[free[goal]], grid[free[start]] = "1", "S"
    return "\n".join("".join(row) for row in grid) + "\n"


def ways(
    rng: np.random.Generator, rows: int, columns: int, first: paths.Cell
) -> Bool[np.ndarray, "R C"]:
    """Digs ways into rock by a depth-first walk over every second cell.

    Args:
      rng: draws where it goes on.
      rows: number of rows inside the outer ring; odd.
      columns: number of columns inside the outer ring; odd.
      first: where it begins, row and column counted over every second cell from 0.

    Returns:
      bool [R, C], cells that are free, outer ring included.
    """
    # Rock beyond the outer ring, so that two steps ahead no cell is missing.
    is_open = np.zeros((rows + 4, columns + 4), bool)
    is_open[[0, -1]] = is_open[:, [0, -1]] = True
    way = [(2 + 2 * first[0], 2 + 2 * first[1])]
    is_open[way[0]] = True

    while way:
        i, j = way[-1]
        ahead = [(i + 2, j), (i - 2, j), (i, j + 2), (i, j - 2)]
        closed = [cell for cell in ahead if not is_open[cell]]
        if not closed:
            way.pop()
            continue

        m, n = closed[rng.integers(len(closed))]
        is_open[m, n] = is_open[(i + m) // 2, (j + n) // 2] = True
        way.append((m, n))
    return is_open[1:-1, 1:-1]
