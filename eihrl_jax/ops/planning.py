"""Value iteration on a grid, differentiable in its rewards and gates (Tamar et al. 2016).

Grids are handled as flat rows with a column of zeros between them, so that a neighbour is a slice
and the loop runs over long stretches of memory. The derivative is written out: what automatic
differentiation makes of a chain of maxima takes three times as long on CPU.
"""

import functools
from typing import cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Num

Four = tuple[Array, Array, Array, Array]
"""One array per direction, in the order of `base.DIRECTIONS_XY`."""


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
        # Which neighbour was the best: 0 to 3 in the order of the directions, -1 outside.
        east, west, north, south = _shifted(values, width)
        across, along = jnp.maximum(east, west), jnp.maximum(north, south)
        best_across, best_along = jnp.where(east >= west, 0, 1), jnp.where(north >= south, 2, 3)
        chosen = _shifted(jnp.where(across >= along, best_across, best_along), width, outside=-1)

        passed = _shifted(of_values * gate, width)
        # My neighbour in x+ hands down to me if its best neighbour is the one in x-, and so on.
        handed = [
            jnp.where(chosen[k] == back, passed[k], 0.0) for k, back in enumerate((1, 0, 3, 2))
        ]
        of_gate += of_values * jnp.maximum(across, along)
        return (functools.reduce(jnp.add, handed), of_reward + of_values, of_gate), None

    nothing = jnp.zeros_like(gate)
    (of_values, of_reward, of_gate), _ = jax.lax.scan(
        iterate, (cotangent, nothing, nothing), before, reverse=True
    )
    return of_reward + of_values, of_gate


_iterate.defvjp(_forward, _backward)


def _shifted(flat: Num[Array, " L"], width: int, outside: int = 0) -> Four:
    """Returns each cell's neighbour in x+, x-, y+ and y- on flat rows of `width`."""
    size = flat.shape[0]
    padded = jnp.pad(flat, width, constant_values=outside)
    starts = (width + 1, width - 1, 0, 2 * width)
    east, west, north, south = (padded[start : start + size] for start in starts)
    return east, west, north, south
