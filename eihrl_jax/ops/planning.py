"""Planning on a grid: value iteration (Tamar et al. 2016), and shortest paths to valuable cells.

Grids come first and batches last, so that what happens in a cell happens in all maps of a batch at
once, along a long stretch of memory. Ways are searched on boards that hold 32 cells in a word. No
derivative is taken: `followed` tells of which cells a value consists, which is all that its
derivative hangs on.
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
"""Stands for minus infinity, of which a gradient would make something that isn't a number."""


GOAL = 1e5
"""What a goal is worth, in moves: more than anything unseen, however far it is."""

_WORD = 32  # cells of a column that a word of a board holds, the northernmost in the lowest bit


class Ways(NamedTuple):
    """What there is to go for, through each of the four cells around the robot's.

    Attributes:
      value: float32 [4, *b], the greatest of what cells are worth less the moves to get there from
        the cell around the robot's; `NOWHERE` where no cell is nearest that way.
      target: int32 [4, *b], the cell with that value, `row * columns + column`; of several the
        first. -1 where there is none.
      moves: float32 [4, *b], moves to it, from the cell around the robot's.
    """

    value: Float[Array, "4 *b"]
    target: Int[Array, "4 *b"]
    moves: Float[Array, "4 *b"]


def value_iteration(
    reward: Float[Array, "n m *b"], gate: Float[Array, "n m *b"], num_iterations: int
) -> tuple[Float[Array, "n m *b"], Float[Array, "K n m *b"]]:
    """Iterates V <- reward + gate * max of V over the four neighbours, from V = reward.

    Args:
      reward: of being in each cell.
      gate: what a cell lets through of its best neighbour's value, its discount; outside the grid
        values are 0.
      num_iterations: cells that values travel.

    Returns:
      V, and what it was before each iteration.

    Source: Tamar et al. 2016, "Value Iteration Networks", Sec. 4.1; one action per neighbour.
    """

    def iterate(values: Float[Array, "n m *b"], _: None) -> tuple[Array, Array]:
        # Tamar et al. 2016, Sec. 4.1: the maximum over actions of what each leads to.
        best = functools.reduce(jnp.maximum, neighbours(values))
        return reward + gate * best, values

    return jax.lax.scan(iterate, reward, None, length=num_iterations)


def followed(before: Float[Array, "K n m *b"], cell: Int[Array, "*b"]) -> Int[Array, "K+1 *b"]:
    """Returns the cells whose rewards and gates a cell's value consists of, itself the first.

    Args:
      before: values before each iteration, see `value_iteration`.
      cell: whose value is asked for, see `Ways.target`.

    Returns:
      The cell, its best neighbour, and so on; of equal ones the first in the order of
      `base.DIRECTIONS_XY`. -1 from where the best one lies outside the grid.
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
    """Searches for what is worth most less the moves to get there, all around the robot.

    It ends when every cell has been reached, or earlier: what is farther away is worth less than
    the greatest worth minus the moves to it, and of the four cells around the robot's none differs
    by more than two moves from the best, since one can come back through the robot's own cell.

    Args:
      worth: of being in each cell, in moves; `NOWHERE` where there is nothing to go for. What is
        more than half of `GOAL` is `GOAL`.
      is_open: cells that can be entered.
      robot: true in one cell, which isn't at the rim and whose own worth doesn't count.
      num_moves: length of the longest way from a cell around the robot's; None: any.

    Returns:
      The ways; exact where a value is above the greatest of the four minus 2.
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
    """What is searched for.

    Attributes:
      targets: board of what is worth something.
      goals: board of those that are goals.
      least: worth of the least that is no goal.
    """

    targets: UInt32[Array, "N m *b"]
    goals: UInt32[Array, "N m *b"]
    least: Float[Array, "*b"]


class _Search(NamedTuple):
    """How far a search has come.

    Attributes:
      num_moves: from the robot to the frontier.
      frontier: boards [4, N, m, *b] of the cells so far away, by the cells around the robot's that
        a shortest way leads through.
      free: board of the open cells that haven't been reached.
      through: boards of all cells that have been reached, as `frontier`.
      bits: boards of the bits of the number of moves to each cell, the lowest first.
      best: at least so much is worth going for among what has been reached.
    """

    num_moves: Int[Array, ""]
    frontier: UInt32[Array, "4 N m *b"]
    free: UInt32[Array, "N m *b"]
    through: UInt32[Array, "4 N m *b"]
    bits: tuple[UInt32[Array, "N m *b"], ...]
    best: Float[Array, "*b"]


def _advance(wanted: _Wanted, search: _Search) -> _Search:
    """Counts the cells of the frontier as reached, and takes it one move further."""
    new = _either(list(search.frontier))
    free = search.free & ~new
    # The bits of the number of moves, on the boards of which they are.
    bits = tuple(
        jnp.where((search.num_moves >> k) & 1 == 1, board | new, board)
        for k, board in enumerate(search.bits)
    )

    # What has been reached is worth at least what the least that is wanted would be.
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
    """Returns the best cell of those to which a shortest way leads through each direction."""
    rows, columns = value.shape[:2]
    cells = jnp.arange(rows * columns).reshape(rows, columns, *(1,) * (value.ndim - 2))
    values, targets = [], []
    for board in through:
        there = jnp.where(unpack(board, rows) > 0, value, NOWHERE)
        greatest = there.max((0, 1))
        # The first that is as great: faster than `argmax`, which goes cell by cell.
        is_it = (there == greatest[None, None]) & (greatest > NOWHERE / 2)[None, None]
        values.append(greatest)
        targets.append(jnp.where(is_it, cells, rows * columns).min((0, 1)))
    target = jnp.stack(targets)
    target = jnp.where(target == rows * columns, -1, target)
    return Ways(jnp.stack(values), target, look_up(moves, target, 0.0))


def look_up(
    grid: Shaped[Array, "n m *b"], cells: Int[Array, "..."], outside: float
) -> Shaped[Array, "..."]:
    """Returns what a grid holds in cells, see `Ways.target`; `outside` for -1."""
    flat = grid.reshape(-1, *grid.shape[2:])
    index = jnp.maximum(cells, 0).reshape(-1, *grid.shape[2:])
    found = jnp.take_along_axis(flat, index, 0, mode="promise_in_bounds").reshape(cells.shape)
    return jnp.where(cells < 0, jnp.asarray(outside, grid.dtype), found)


def at_sides(grid: Shaped[Array, "n m *b"], robot: Bool[Array, "n m *b"]) -> Shaped[Array, "4 *b"]:
    """Returns what a grid holds in the four cells around the robot's, which isn't at the rim."""
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
    """Returns a board whose cells have moved by one in x+, x-, y+ and y-."""
    nothing = [(0, 0)] * (board.ndim - 2)
    east = jnp.pad(board[:, :-1], [(0, 0), (1, 0), *nothing])
    west = jnp.pad(board[:, 1:], [(0, 0), (0, 1), *nothing])
    # From one word into the next, the lowest bit being the northernmost cell.
    into_south = jnp.pad(board[:-1] >> (_WORD - 1), [(1, 0), (0, 0), *nothing])
    into_north = jnp.pad(board[1:] << (_WORD - 1), [(0, 1), (0, 0), *nothing])
    return east, west, (board >> 1) | into_north, (board << 1) | into_south


def _either(boards: Sequence[UInt32[Array, "N m *b"]]) -> UInt32[Array, "N m *b"]:
    """Returns the cells that are on any of some boards."""
    return functools.reduce(jnp.bitwise_or, boards)


def _steps(columns: int, num_axes: int) -> Int[Array, "4 *ones"]:
    """Returns what each direction adds to the number of a cell."""
    return jnp.array([1, -1, -columns, columns]).reshape(4, *(1,) * num_axes)
