"""What a batch computes for some of its rows only."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

ResultT = TypeVar("ResultT")

_NUM_CHUNKS = 8
"""Into so many parts the rows of a batch are divided; as few are computed as hold those needed."""


def where_needed(
    condition: Bool[Array, ""],
    compute: Callable[[Any], ResultT],
    argument: Any,
    otherwise: ResultT,
) -> ResultT:
    """Returns `compute(argument)` where a condition holds, and `otherwise` where it doesn't.

    Under `vmap`, `jnp.where` and `lax.cond` compute both for every row. This gathers the rows for
    which the condition holds and computes those alone, an eighth of the batch at a time. It has no
    derivative.

    Args:
      condition: whether it is needed.
      compute: from a pytree of arrays to one of the structure, shapes and types of `otherwise`.
      argument: of `compute`.
      otherwise: a pytree of arrays.

    >>> argument, otherwise = jnp.arange(4.0), jnp.zeros(4)
    >>> root = lambda condition, x, zero: where_needed(condition, jnp.sqrt, x, zero)
    >>> [float(x) for x in jax.vmap(root)(argument > 3.5 - argument, argument, otherwise)]
    [0.0, 0.0, 1.4142135381698608, 1.7320507764816284]
    """

    @jax.custom_batching.custom_vmap
    def chosen(condition: Bool[Array, ""], argument: Any, otherwise: ResultT) -> ResultT:
        return jax.lax.cond(condition, lambda: compute(argument), lambda: otherwise)

    @chosen.def_vmap
    def _chosen_rows(size: int, is_batched: Any, *arguments: Any) -> tuple[ResultT, Any]:
        condition, argument, otherwise = jax.tree.map(
            lambda leaf, batched: leaf if batched else jnp.broadcast_to(leaf, (size, *leaf.shape)),
            arguments,
            tuple(is_batched),
        )
        rows = _rows_where_needed(condition, compute, argument, otherwise)
        return rows, jax.tree.map(lambda _: True, rows)

    return chosen(condition, argument, otherwise)


def _rows_where_needed(
    condition: Bool[Array, " N"],
    compute: Callable[[Any], ResultT],
    argument: Any,
    otherwise: ResultT,
) -> ResultT:
    """Returns what `where_needed` says, of all rows of a batch of N."""
    size = condition.shape[0]
    chunk = -(-size // _NUM_CHUNKS)
    # Behind those needed stand rows that are none: gathered anywhere and written nowhere.
    needed = jnp.nonzero(condition, size=_NUM_CHUNKS * chunk, fill_value=size)[0]

    def fill(filled: tuple[Array, ResultT]) -> tuple[Array, ResultT]:
        start, result = filled
        here = jax.lax.dynamic_slice_in_dim(needed, start, chunk)
        some = jax.tree.map(lambda leaf: leaf.at[here].get(mode="clip"), argument)
        computed = jax.vmap(compute)(some)
        result = jax.tree.map(lambda old, new: old.at[here].set(new, mode="drop"), result, computed)
        return start + chunk, result

    num_needed = condition.sum()
    start = jnp.zeros_like(num_needed)
    return jax.lax.while_loop(lambda filled: filled[0] < num_needed, fill, (start, otherwise))[1]
