"""Planning on a grid: value iteration (Tamar et al. 2016), and shortest ways to what is worth most.

Both are differentiable, the one in its rewards and gates, the other in its worths. Grids are
handled as flat rows with a column of nothing between them, so that a neighbour is a slice and the
loop runs over long stretches of memory. The derivatives are written out: what automatic
differentiation makes of a chain of maxima takes three times as long on CPU.
"""

import functools
from typing import cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Num, Shaped

Four = tuple[Array, Array, Array, Array]
"""One array per direction, in the order of `base.DIRECTIONS_XY`."""

NOWHERE = -1e9
"""Stands for minus infinity, of which a gradient would make something that isn't a number."""


GOAL = 1e5
"""What a goal is worth, in moves: more than anything unseen, however far it is."""


def value_iteration(
    reward: Float[Array, "n m"], gate: Float[Array, "n m"], num_iterations: int
) -> Float[Array, "n m"]:
    """Iterates V <- reward + gate * max of V over the four neighbours, from V = reward.

    Args:
      reward: of being in each cell.
      gate: what a cell lets through of its best neighbour's value, its discount; outside the grid
        values are 0.
      num_iterations: cells that values travel.

    Returns:
      V. Where neighbours are equal, the derivative follows the first in the order of
      `base.DIRECTIONS_XY`.

    Source: Tamar et al. 2016, "Value Iteration Networks", Sec. 4.1; one action per neighbour.
    """
    # The column of zeros keeps a row's end from being the neighbour of the next row's start.
    width = reward.shape[1] + 1
    flat_reward, flat_gate = (jnp.pad(grid, ((0, 0), (0, 1))).ravel() for grid in (reward, gate))
    values = cast(Array, _iterate(flat_reward, flat_gate, width, num_iterations))
    return values.reshape(-1, width)[:, :-1]


def reach(
    worth: Float[Array, "n m"], is_open: Bool[Array, "n m"], num_moves: int
) -> Float[Array, "n m"]:
    """Returns the greatest of what cells are worth less the moves to get there.

    Iterates U <- max(worth, max of U over the four neighbours - 1) in open cells, from U = worth:
    the fixed point is reached after as many iterations as the longest way that matters has moves.

    Args:
      worth: of being in each cell, in moves; `NOWHERE` where there is nothing to go for.
      is_open: cells that can be entered; the others have `NOWHERE`.
      num_moves: length of the longest way that is looked at.

    Returns:
      U; `NOWHERE`, or less than half of it, where nothing is within reach. Where ways are equally
      good, the derivative follows the first in the order of `base.DIRECTIONS_XY`; ways that
      `num_moves` cuts off it leaves out.
    """
    width = worth.shape[1] + 1
    flat_worth, flat_open = _flat(worth, is_open)
    values = cast(Array, _reach(flat_worth, flat_open, width, num_moves))
    return values.reshape(-1, width)[:, :-1]


def search(
    worth: Float[Array, "n m"], is_open: Bool[Array, "n m"], robot: Bool[Array, "n m"]
) -> Float[Array, "n m"]:
    """Returns what `reach` does for any number of moves, right in the four cells around the robot.

    It ends when nothing changes any more, or earlier: a way of more moves than were looked at is
    worth less than the greatest worth minus these, and the four cells differ by two moves at most,
    since the robot's own cell lies between them.

    Args:
      worth: see `reach`.
      is_open: see `reach`.
      robot: true in one cell.

    Returns:
      U, exact where it is above the greatest U around the robot minus 2.
    """
    # On CPU a large map stays in the cache, and each of many has as many sweeps as it needs itself:
    # 64 maps of 117 x 117 cells take two fifths of the time that they take all at once.
    is_cpu = jax.default_backend() == "cpu"
    return (_search_one_by_one if is_cpu else _search)(worth, is_open, robot)


def _search(
    worth: Float[Array, "n m"], is_open: Bool[Array, "n m"], robot: Bool[Array, "n m"]
) -> Float[Array, "n m"]:
    """Searches one map, see `search`."""
    width = worth.shape[1] + 1
    flat_worth, flat_open = _flat(worth, is_open)
    greatest = flat_worth.max()
    beside = _beside(jnp.pad(robot, ((0, 0), (0, 1))))
    beside = jnp.where(beside < 0, flat_worth.size, beside)  # outside, as what is too far behind

    def is_unsettled(carry: tuple[Array, Array, Array]) -> Array:
        values, num_moves, has_changed = carry
        best = values.at[beside].get(mode="fill", fill_value=NOWHERE).max()
        return has_changed & (greatest - num_moves - 1.0 > best - 2.0)

    def advance(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        values, num_moves, _ = carry
        further = _sweep(flat_worth, flat_open, values, width)
        return further, num_moves + 1.0, (further != values).any()

    start = (flat_worth, jnp.float32(0.0), jnp.array(True))
    values, _, _ = jax.lax.while_loop(is_unsettled, advance, start)
    return values.reshape(-1, width)[:, :-1]


@jax.custom_batching.sequential_vmap
def _search_one_by_one(
    worth: Float[Array, "n m"], is_open: Bool[Array, "n m"], robot: Bool[Array, "n m"]
) -> Float[Array, "n m"]:
    """Searches one map, and many one after the other."""
    return _search(worth, is_open, robot)


def at_sides(grid: Shaped[Array, "n m"], robot: Bool[Array, "n m"]) -> Shaped[Array, "4"]:
    """Returns what a grid holds in the four cells around the robot's, which isn't at the rim."""
    return grid.ravel()[_beside(robot)]


def neighbours(grid: Num[Array, "*k n m"]) -> Four:
    """Returns for each cell its neighbour in x+, x-, y+ and y-; 0 outside. Row 0 is the north."""
    padded = jnp.pad(grid, [(0, 0)] * (grid.ndim - 2) + [(1, 1), (1, 1)])
    rows, columns = grid.shape[-2:]
    corners = ((1, 2), (1, 0), (0, 1), (2, 1))
    east, west, north, south = (padded[..., i : i + rows, j : j + columns] for i, j in corners)
    return east, west, north, south


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def _iterate(
    reward: Float[Array, " L"], gate: Float[Array, " L"], width: int, num_iterations: int
) -> Float[Array, " L"]:
    """Iterates values on flat rows of `width`, see `value_iteration`."""
    return _forward(reward, gate, width, num_iterations)[0]


def _forward(
    reward: Float[Array, " L"], gate: Float[Array, " L"], width: int, num_iterations: int
) -> tuple[Float[Array, " L"], tuple[Float[Array, " L"], Float[Array, "K L"]]]:
    """Returns V, and what its derivative needs: the gate, and V before each iteration."""

    def iterate(values: Float[Array, " L"], _: None) -> tuple[Array, Array]:
        east, west, north, south = _shifted(values, width)
        # Tamar et al. 2016, Sec. 4.1: the maximum over actions of what each leads to.
        best = jnp.maximum(jnp.maximum(east, west), jnp.maximum(north, south))
        return reward + gate * best, values

    values, before = jax.lax.scan(iterate, reward, None, length=num_iterations)
    return values, (gate, before)


def _backward(
    width: int,
    num_iterations: int,
    residuals: tuple[Float[Array, " L"], Float[Array, "K L"]],
    cotangent: Float[Array, " L"],
) -> tuple[Float[Array, " L"], Float[Array, " L"]]:
    """Follows the best neighbours back, from V's cotangent to those of reward and gate."""
    del num_iterations
    gate, before = residuals

    def iterate(
        carry: tuple[Array, Array, Array], values: Float[Array, " L"]
    ) -> tuple[tuple[Array, Array, Array], None]:
        of_values, of_reward, of_gate = carry
        around = _shifted(values, width)
        passed = _shifted(of_values * gate, width)
        # A neighbour hands down to me if I am its best neighbour.
        handed = [
            jnp.where(is_best, each, 0.0)
            for is_best, each in zip(_is_best_of_neighbour(around, width), passed, strict=True)
        ]
        of_gate += of_values * functools.reduce(jnp.maximum, around)
        return (functools.reduce(jnp.add, handed), of_reward + of_values, of_gate), None

    nothing = jnp.zeros_like(gate)
    (of_values, of_reward, of_gate), _ = jax.lax.scan(
        iterate, (cotangent, nothing, nothing), before, reverse=True
    )
    return of_reward + of_values, of_gate


_iterate.defvjp(_forward, _backward)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2, 3))
def _reach(
    worth: Float[Array, " L"], is_open: Bool[Array, " L"], width: int, num_moves: int
) -> Float[Array, " L"]:
    """Iterates on flat rows of `width`, see `reach`."""
    return _reach_forward(worth, is_open, width, num_moves)[0]


def _reach_forward(
    worth: Float[Array, " L"], is_open: Bool[Array, " L"], width: int, num_moves: int
) -> tuple[Float[Array, " L"], tuple[Float[Array, " L"], Float[Array, " L"]]]:
    """Returns U, and what its derivative needs: the worth and U."""

    def advance(_: Int[Array, ""], values: Float[Array, " L"]) -> Float[Array, " L"]:
        return _sweep(worth, is_open, values, width)

    values = jax.lax.fori_loop(0, num_moves, advance, worth)
    return values, (worth, values)


def _reach_backward(
    width: int,
    num_moves: int,
    residuals: tuple[Float[Array, " L"], Float[Array, " L"]],
    cotangent: Float[Array, " L"],
) -> tuple[Float[Array, " L"], None]:
    """Follows each cell's way to what it goes for, whose worth gets the cell's cotangent."""
    worth, values = residuals
    is_end = values <= worth
    # Ways are chains of best neighbours, as U has them at the end; who has arrived stays.
    around = _shifted(values, width, outside=NOWHERE)
    is_on_the_way = _shifted(jnp.where(is_end, 0.0, 1.0), width)
    comes_from = [
        jnp.where(is_best, on_the_way, 0.0)
        for is_best, on_the_way in zip(
            _is_best_of_neighbour(around, width), is_on_the_way, strict=True
        )
    ]

    def advance(_: Int[Array, ""], carry: tuple[Array, Array]) -> tuple[Array, Array]:
        on_the_way, arrived = carry
        passed = _shifted(on_the_way, width)
        on_the_way = functools.reduce(
            jnp.add, [comes * each for comes, each in zip(comes_from, passed, strict=True)]
        )
        return on_the_way, arrived + jnp.where(is_end, on_the_way, 0.0)

    on_the_way = jnp.where(values <= NOWHERE / 2, 0.0, cotangent)
    start = (on_the_way, jnp.where(is_end, on_the_way, 0.0))
    _, arrived = jax.lax.fori_loop(0, num_moves, advance, start)
    return arrived, None


_reach.defvjp(_reach_forward, _reach_backward)


def _sweep(
    worth: Float[Array, " L"], is_open: Bool[Array, " L"], values: Float[Array, " L"], width: int
) -> Float[Array, " L"]:
    """Lets values come one move further."""
    best = functools.reduce(jnp.maximum, _shifted(values, width, outside=NOWHERE))
    return jnp.where(is_open, jnp.maximum(worth, best - 1.0), NOWHERE)


def _is_best_of_neighbour(around: Four, width: int) -> Four:
    """Returns for each direction whether a cell is the best neighbour of its neighbour there.

    Args:
      around: the values of each cell's neighbours, on flat rows of `width`.
      width: of a row.
    """
    # Which neighbour is the greatest: 0 to 3 in the order of the directions, -1 outside.
    east, west, north, south = around
    across, along = jnp.maximum(east, west), jnp.maximum(north, south)
    best_across, best_along = jnp.where(east >= west, 0, 1), jnp.where(north >= south, 2, 3)
    chosen = _shifted(jnp.where(across >= along, best_across, best_along), width, outside=-1)

    # I am the best neighbour of mine in x+ if it chose the one in x-, and so on.
    east, west, north, south = (chosen[k] == back for k, back in enumerate((1, 0, 3, 2)))
    return east, west, north, south


def _beside(robot: Bool[Array, "n m"]) -> Int[Array, "4"]:
    """Returns the flat indices of the four cells around the robot's."""
    columns = robot.shape[1]
    return jnp.argmax(robot) + jnp.array([1, -1, -columns, columns])


def _flat(
    worth: Float[Array, "n m"], is_open: Bool[Array, "n m"]
) -> tuple[Float[Array, " L"], Bool[Array, " L"]]:
    """Returns flat rows with a closed column between them, nothing being worth anything there."""
    flat_worth = jnp.pad(
        jnp.where(is_open, worth, NOWHERE), ((0, 0), (0, 1)), constant_values=NOWHERE
    )
    return flat_worth.ravel(), jnp.pad(is_open, ((0, 0), (0, 1))).ravel()


def _shifted(flat: Num[Array, " L"], width: int, outside: float = 0) -> Four:
    """Returns each cell's neighbour in x+, x-, y+ and y- on flat rows of `width`."""
    size = flat.shape[0]
    padded = jnp.pad(flat, width, constant_values=outside)
    starts = (width + 1, width - 1, 0, 2 * width)
    east, west, north, south = (padded[start : start + size] for start in starts)
    return east, west, north, south
