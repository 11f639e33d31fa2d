"""Planning on a grid: value iteration (Tamar et al. 2016), and shortest paths to valuable cells.

The grid's axes come first and the batch's last, so an operation on a cell runs over all maps of a
batch in contiguous memory. Paths are searched on bitboards that hold 32 cells in a word. Nothing
here is differentiated: `followed` returns the cells that a value is a sum over, from which its
gradient can be computed.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Num, Shaped, UInt32

Four = tuple[Array, Array, Array, Array]
"""One array per direction, in the order of `base.DIRECTIONS_XY`."""

NOWHERE = -1e9
"""Stands for minus infinity, with which gradients would be NaN."""

GOAL = 1e5
"""Worth of a goal, in moves: more than that of any unseen cell, however far the goal is."""

_WORD = 32  # cells of a column that a word of a board holds, the northernmost in the lowest bit


class Ways(NamedTuple):
    """The best cell to reach through each of the four neighbours of the robot's cell.

    Attributes:
      value: float32 [4, *b], the greatest worth of a cell less the moves to it from the neighbour;
        `NOWHERE` if no shortest path leads through the neighbour.
      target: int32 [4, *b], the cell with that value, `row * columns + column`; of several the
        first. -1 if there is none.
      moves: float32 [4, *b], moves to it from the neighbour.
    """

    value: Float[Array, "4 *b"]
    target: Int[Array, "4 *b"]
    moves: Float[Array, "4 *b"]


def value_iteration(
    reward: Float[Array, "n m *b"], gate: Float[Array, "n m *b"], num_iterations: int
) -> tuple[Float[Array, "n m *b"], Float[Array, "K n m *b"]]:
    """Iterates V <- reward + gate * max of V over the four neighbours, from V = reward.

    Args:
      reward: of each cell.
      gate: discount of each cell, by which its best neighbour's value is multiplied; outside the
        grid values are 0.
      num_iterations: how many cells values spread.

    Returns:
      V, and the values before each iteration.

    Source: Tamar et al. 2016, "Value Iteration Networks", Sec. 4.1; one action per neighbour.
    """

    def iterate(values: Float[Array, "n m *b"], _: None) -> tuple[Array, Array]:
        # Tamar et al. 2016, Sec. 4.1: the maximum over actions of what each leads to.
        best = functools.reduce(jnp.maximum, neighbours(values))
        return reward + gate * best, values

    return jax.lax.scan(iterate, reward, None, length=num_iterations)


def followed(before: Float[Array, "K n m *b"], cell: Int[Array, "*b"]) -> Int[Array, "K+1 *b"]:
    """Returns the cells whose rewards and gates make up a cell's value, beginning with itself.

    Args:
      before: values before each iteration, see `value_iteration`.
      cell: index of the cell, see `Ways.target`.

    Returns:
      The cell, its best neighbour, and so on; of equal ones the first in the order of
      `base.DIRECTIONS_XY`. -1 from the first one outside the grid on.
    """
    rows, columns = before.shape[1:3]

    def follow(
        cell: Int[Array, "*b"], values: Float[Array, "n m *b"]
    ) -> tuple[Int[Array, "*b"], Int[Array, "*b"]]:
        i, j = cell // columns, cell % columns
        is_inside = jnp.stack([j < columns - 1, j > 0, i > 0, i < rows - 1]) & (cell >= 0)[None]
        around = jnp.where(is_inside, cell[None] + _steps(columns, cell.ndim), -1)
        best = jnp.argmax(look_up(values, around, 0.0), 0)
        cell = jnp.take_along_axis(around, best[None], 0)[0]
        return cell, cell

    _, cells = jax.lax.scan(follow, cell, before, reverse=True)
    return jnp.concatenate([cell[None], cells[::-1]])


def search(
    worth: Float[Array, "n m *b"],
    is_open: Bool[Array, "n m *b"],
    robot: Bool[Array, "n m *b"],
    num_moves: int | None = None,
) -> Ways:
    """Searches, breadth first, for the cells whose worth less the moves to them is greatest.

    It ends when every cell has been reached, or earlier, when no farther cell can be better: its
    value is at most the greatest worth less the moves to it, and the values of the four neighbours
    differ by two moves at most, because a path may lead back through the robot's own cell.

    Args:
      worth: of each cell, in moves; `NOWHERE` for a cell without worth. What is more than half of
        `GOAL` counts as `GOAL`.
      is_open: cells that can be entered.
      robot: true in one cell, which isn't at the border and whose own worth doesn't count.
      num_moves: length of the longest path from a neighbour of the robot's cell; None: any.

    Returns:
      The best cells; exact where a value is above the greatest of the four minus 2.
    """
    rows, columns = worth.shape[:2]
    is_target = is_open & ~robot & (worth > NOWHERE / 2)
    is_goal = is_target & (worth > GOAL / 2)
    greatest = jnp.where(is_target, worth, NOWHERE).max((0, 1))
    least = jnp.where(is_target & ~is_goal, worth, GOAL).min((0, 1))
    wanted = _Wanted(pack(is_target), pack(is_goal), least)

    farthest = rows * columns if num_moves is None else num_moves + 1
    here, free = pack(robot), pack(is_open)
    frontier = jnp.stack(_moved(here)) & free[None]
    start = _Search(
        num_moves=jnp.int32(1),
        frontier=frontier,
        free=free & ~here,
        through=jnp.zeros_like(frontier),
        bits=(jnp.zeros_like(here),) * farthest.bit_length(),
        best=jnp.full_like(greatest, NOWHERE),
    )

    def is_unsettled(search: _Search) -> Bool[Array, ""]:
        could_be = greatest - search.num_moves.astype(jnp.float32)
        is_left = (search.frontier != 0).any((0, 1, 2)) & (could_be > search.best - 2.0)
        return (search.num_moves <= farthest) & is_left.any()

    end = jax.lax.while_loop(is_unsettled, functools.partial(_advance, wanted), start)
    moves = sum(unpack(board, rows) << k for k, board in enumerate(end.bits))
    moves = jnp.asarray(moves).astype(jnp.float32) - 1.0
    return _best(jnp.where(is_target, worth - moves, NOWHERE), end.through, moves)


class _Wanted(NamedTuple):
    """The targets of a search.

    Attributes:
      targets: board of the cells with a worth.
      goals: board of those that are goals.
      least: smallest worth of a target that isn't a goal.
    """

    targets: UInt32[Array, "N m *b"]
    goals: UInt32[Array, "N m *b"]
    least: Float[Array, "*b"]


class _Search(NamedTuple):
    """The state of a search.

    Attributes:
      num_moves: from the robot to the frontier.
      frontier: boards [4, N, m, *b] of the cells at this distance, by the neighbours of the robot's
        cell through which a shortest path leads.
      free: board of the open cells that haven't been reached.
      through: boards of all cells that have been reached, as `frontier`.
      bits: boards of the bits of the number of moves to each cell, the lowest first.
      best: lower bound of the best value among the cells that have been reached.
    """

    num_moves: Int[Array, ""]
    frontier: UInt32[Array, "4 N m *b"]
    free: UInt32[Array, "N m *b"]
    through: UInt32[Array, "4 N m *b"]
    bits: tuple[UInt32[Array, "N m *b"], ...]
    best: Float[Array, "*b"]


def _advance(wanted: _Wanted, search: _Search) -> _Search:
    """Marks the frontier's cells as reached, and moves the frontier by one."""
    new = _either(list(search.frontier))
    free = search.free & ~new
    # Board k holds bit k of the number of moves.
    bits = tuple(
        jnp.where((search.num_moves >> k) & 1 == 1, board | new, board)
        for k, board in enumerate(search.bits)
    )

    # A target that has just been reached is worth at least the least worth of any.
    at_least = jnp.where((new & wanted.goals).any((0, 1)), GOAL, wanted.least)
    at_least -= search.num_moves.astype(jnp.float32)
    best = jnp.where((new & wanted.targets).any((0, 1)), at_least, NOWHERE)

    further = jax.vmap(lambda board: _either(_moved(board)))(search.frontier)
    return _Search(
        num_moves=search.num_moves + 1,
        frontier=further & free[None],
        free=free,
        through=search.through | search.frontier,
        bits=bits,
        best=jnp.maximum(search.best, best),
    )


def _best(
    value: Float[Array, "n m *b"],
    through: UInt32[Array, "4 N m *b"],
    moves: Float[Array, "n m *b"],
) -> Ways:
    """Returns the best cell among those with a shortest path through each neighbour."""
    rows, columns = value.shape[:2]
    cells = jnp.arange(rows * columns).reshape(rows, columns, *(1,) * (value.ndim - 2))
    values, targets = [], []
    for board in through:
        there = jnp.where(unpack(board, rows) > 0, value, NOWHERE)
        greatest = there.max((0, 1))
        # The first of the greatest: faster than `argmax`, which isn't vectorised on CPU.
        is_it = (there == greatest[None, None]) & (greatest > NOWHERE / 2)[None, None]
        values.append(greatest)
        targets.append(jnp.where(is_it, cells, rows * columns).min((0, 1)))
    target = jnp.stack(targets)
    target = jnp.where(target == rows * columns, -1, target)
    return Ways(jnp.stack(values), target, look_up(moves, target, 0.0))


def look_up(
    grid: Shaped[Array, "n m *b"], cells: Int[Array, "..."], outside: float
) -> Shaped[Array, "..."]:
    """Returns a grid's entries at cells, see `Ways.target`; `outside` for -1."""
    flat = grid.reshape(-1, *grid.shape[2:])
    index = jnp.maximum(cells, 0).reshape(-1, *grid.shape[2:])
    found = jnp.take_along_axis(flat, index, 0, mode="promise_in_bounds").reshape(cells.shape)
    return jnp.where(cells < 0, jnp.asarray(outside, grid.dtype), found)


def at_sides(grid: Shaped[Array, "n m *b"], robot: Bool[Array, "n m *b"]) -> Shaped[Array, "4 *b"]:
    """Returns a grid's entries at the four neighbours of the robot's cell, not at the border."""
    columns = grid.shape[1]
    here = jnp.argmax(robot.reshape(-1, *robot.shape[2:]), 0)
    return look_up(grid, here[None] + _steps(columns, here.ndim), 0)


def neighbours(grid: Num[Array, "n m *b"]) -> Four:
    """Returns for each cell its neighbour in x+, x-, y+ and y-; 0 outside. Row 0 is the north."""
    padded = jnp.pad(grid, [(1, 1), (1, 1), *[(0, 0)] * (grid.ndim - 2)])
    rows, columns = grid.shape[:2]
    corners = ((1, 2), (1, 0), (0, 1), (2, 1))
    east, west, north, south = (padded[i : i + rows, j : j + columns] for i, j in corners)
    return east, west, north, south


def pack(grid: Bool[Array, "n m *b"]) -> UInt32[Array, "N m *b"]:
    """Packs the cells of a column into the bits of words."""
    words = []
    for first in range(0, grid.shape[0], _WORD):
        cells = grid[first : first + _WORD]
        bits = jnp.uint32(1) << jnp.arange(len(cells), dtype=jnp.uint32)
        bits = bits.reshape(-1, *(1,) * (grid.ndim - 1))
        words.append(jnp.where(cells, bits, jnp.uint32(0)).sum(0, dtype=jnp.uint32))
    return jnp.stack(words)


def unpack(board: UInt32[Array, "N m *b"], rows: int) -> UInt32[Array, "n m *b"]:
    """Returns 1 for the cells on a board of so many rows, see `pack`, and 0 for the others."""
    parts = []
    for word, first in zip(board, range(0, rows, _WORD), strict=True):
        shifts = jnp.arange(min(_WORD, rows - first), dtype=jnp.uint32)
        parts.append((word[None] >> shifts.reshape(-1, *(1,) * word.ndim)) & 1)
    return jnp.concatenate(parts)


def _moved(board: UInt32[Array, "N m *b"]) -> Four:
    """Returns four boards, shifted by one cell in x+, x-, y+ and y-."""
    nothing = [(0, 0)] * (board.ndim - 2)
    east = jnp.pad(board[:, :-1], [(0, 0), (1, 0), *nothing])
    west = jnp.pad(board[:, 1:], [(0, 0), (0, 1), *nothing])
    # The carry from one word to the next; the lowest bit is the northernmost cell.
    into_south = jnp.pad(board[:-1] >> (_WORD - 1), [(1, 0), (0, 0), *nothing])
    into_north = jnp.pad(board[1:] << (_WORD - 1), [(0, 1), (0, 0), *nothing])
    return east, west, (board >> 1) | into_north, (board << 1) | into_south


def _either(boards: Sequence[UInt32[Array, "N m *b"]]) -> UInt32[Array, "N m *b"]:
    """Returns the union of boards."""
    return functools.reduce(jnp.bitwise_or, boards)


def _steps(columns: int, num_axes: int) -> Int[Array, "4 *ones"]:
    """Returns the offset of a cell's index for each direction."""
    return jnp.array([1, -1, -columns, columns]).reshape(4, *(1,) * num_axes)
