"""The maze pytree: a maze is data, so one compiled program serves every maze.

Layouts are padded with wall to a common shape before they are stacked, which leaves coordinates
as they were because the origin is the outer top-left corner (see `base`).
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, Num, UInt8
from scipy import ndimage

from eihrl_jax import base

MAX_GOALS = 9  # a goal is one digit in the text

WALL = 128
"""Code of a wall cell in `codes`."""


class Maze(struct.PyTreeNode):
    """One maze, or with a leading axis many of them. R rows and C columns include the outer ring.

    Attributes:
      wall: bool [R, C], true where a body can't be.
      goal: int32 [R, C], number of the goal region of a cell, 1 to 9, or 0.
      start: bool [R, C], cells in which an episode may start.
      door: bool [R, C], candidates of which `open_door` makes one goal 1: those in walls are doors,
        the others stay free.
      start_jitter: float32, half-width of the uniform offset from the start cell's centre, units.
      num_goals: int32, number of goals of an episode.
      num_decisions: int32, time limit in subgoals (paper, Table 3 divided by 25).

    >>> from eihrl_jax import mazes
    >>> maze = mazes.load("u")
    >>> maze.wall.shape, int(maze.num_goals)
    ((9, 9), 1)
    """

    wall: Bool[Array, "R C"]
    goal: Int[Array, "R C"]
    start: Bool[Array, "R C"]
    door: Bool[Array, "R C"]
    start_jitter: Float[Array, ""]
    num_goals: Int[Array, ""]
    num_decisions: Int[Array, ""]


def cell_ij(xy: Float[Array, "2"]) -> Int[Array, "2"]:
    """Returns row and column of the cell around a position in units; may lie outside the grid."""
    # y points up and rows are counted downwards.
    column_row = jnp.floor(xy * jnp.array([1.0, -1.0]) / base.CELL)
    return column_row[::-1].astype(jnp.int32)


def cell_xy(ij: Num[Array, "2"]) -> Float[Array, "2"]:
    """Returns the centre, in units, of the cell at row and column `ij`, which may be fractions."""
    return (ij[::-1].astype(jnp.float32) + 0.5) * jnp.array([base.CELL, -base.CELL])


def is_wall(maze: Maze, xy: Float[Array, "2"]) -> Bool[Array, ""]:
    """Returns whether a position is inside a wall; everything outside the grid is."""
    # A negative index must not count from the other end: it lies outside as well.
    i, j = cell_ij(xy)
    return maze.wall.at[i, j].get(mode="fill", fill_value=True, wrap_negative_indices=False)


def goal_at(maze: Maze, xy: Float[Array, "2"]) -> Int[Array, ""]:
    """Returns the number of the goal region at a position, 0 where there is none."""
    i, j = cell_ij(xy)
    return maze.goal.at[i, j].get(mode="fill", fill_value=0, wrap_negative_indices=False)


def codes(maze: Maze) -> UInt8[Array, "*m R C"]:
    """Packs walls and goals into one byte per cell: `WALL`, else the goal's number, else 0."""
    return jnp.where(maze.wall, WALL, maze.goal).astype(jnp.uint8)


def draw_cell(mask: Bool[Array, "R C"], key: Key[Array, ""]) -> Int[Array, "2"]:
    """Draws row and column of one of the true cells of `mask`, all equally likely."""
    # The true cells are numbered in reading order; the first one past the drawn number is taken.
    rank = jnp.cumsum(mask.ravel())
    drawn = jax.random.uniform(key) * rank[-1].astype(jnp.float32)
    index = jnp.searchsorted(rank, drawn.astype(jnp.int32), side="right")
    return jnp.stack(jnp.divmod(index, mask.shape[1])).astype(jnp.int32)


def open_door(maze: Maze, ij: Int[Array, "2"]) -> Maze:
    """Makes the candidate at row and column `ij` goal 1; the other door candidates stay wall.

    Where there is no candidate, such as outside the grid, none opens.
    """
    rows, columns = jnp.indices(maze.door.shape, sparse=True)
    is_open = maze.door & (rows == ij[0]) & (columns == ij[1])
    return maze.replace(
        wall=maze.wall & ~is_open,
        goal=jnp.where(is_open, 1, maze.goal),
    )


def draw_start(maze: Maze, key: Key[Array, ""]) -> Float[Array, "2"]:
    """Draws a start position in units: a start cell, then a uniform offset from its centre."""
    cell_key, offset_key = jax.random.split(key)
    offset = jax.random.uniform(offset_key, (2,), minval=-1.0, maxval=1.0)
    return cell_xy(draw_cell(maze.start, cell_key)) + maze.start_jitter * offset


def goal_places(goal: Int[np.ndarray, "R C"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Returns where each goal is, on the host: the middle of its region.

    A region in several parts, or whose middle isn't in it, is wherever one of its cells is: a point
    between them may be a wall.

    Args:
      goal: numbers of goal regions, as `Maze` has them.

    Returns:
      For each of `MAX_GOALS` goals some positions in units, the nearest of which counts; one at 0
      for an absent goal.
    """
    places = []
    for number in range(1, MAX_GOALS + 1):
        cells = np.argwhere(goal == number)
        middle = cells.mean(0, keepdims=True) if len(cells) else np.full((1, 2), -0.5)
        parts = np.zeros(goal.shape, np.int32)
        ndimage.label(goal == number, output=parts)  # numbers them from 1 on
        is_in = (cells == np.floor(middle + 0.5)).all(1).any()
        if len(cells) and not (is_in and parts.max() == 1):
            middle = cells
        places.append(((middle[:, ::-1] + 0.5) * (base.CELL, -base.CELL)).astype(np.float32))
    return places


def stack(mazes: list[Maze]) -> Maze:
    """Stacks mazes along a new leading axis, padded with wall to the largest of them.

    Coordinates stay as they were: padding is below and to the right.
    """
    rows = max(maze.wall.shape[0] for maze in mazes)
    columns = max(maze.wall.shape[1] for maze in mazes)

    # In NumPy: JAX would compile the padding of every shape.
    def pad(grid: Array | np.ndarray, value: bool | int) -> np.ndarray:
        margin = ((0, rows - grid.shape[0]), (0, columns - grid.shape[1]))
        return np.pad(np.asarray(grid), margin, constant_values=value)

    padded = [
        maze.replace(
            wall=pad(maze.wall, True),
            goal=pad(maze.goal, 0),
            start=pad(maze.start, False),
            door=pad(maze.door, False),
        )
        for maze in mazes
    ]
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *padded))
