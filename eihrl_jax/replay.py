"""Replay memory: a ring of rows on the device, as a pytree."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Int, Key


@struct.dataclass
class Replay:
    """A ring buffer. C: capacity.

    Attributes:
      rows: pytree whose leaves are [C, ...].
      position: int32, where the next row goes.
      size: int32, number of rows that hold data.
    """

    rows: Any
    position: Int[Array, ""]
    size: Int[Array, ""]


def init(example: Any, capacity: int) -> Replay:
    """Returns an empty memory for `capacity` rows shaped like the pytree `example`."""
    rows = jax.tree.map(lambda x: jnp.zeros((capacity, *x.shape), x.dtype), example)
    return Replay(rows=rows, position=jnp.int32(0), size=jnp.int32(0))


def add(replay: Replay, batch: Any) -> Replay:
    """Appends a batch of rows [N, ...]; the oldest rows make room.

    N must divide the capacity, so that a batch never wraps around the end.

    Raises:
      ValueError: it doesn't.
    """
    capacity = jax.tree.leaves(replay.rows)[0].shape[0]
    num_rows = jax.tree.leaves(batch)[0].shape[0]
    if capacity % num_rows:
        raise ValueError(f"capacity {capacity} is no multiple of the batch's {num_rows} rows")

    def write(rows: Array, new: Array) -> Array:
        return jax.lax.dynamic_update_slice_in_dim(rows, new, replay.position, axis=0)

    return Replay(
        rows=jax.tree.map(write, replay.rows, batch),
        position=(replay.position + num_rows) % capacity,
        size=jnp.minimum(replay.size + num_rows, capacity),
    )


def sample(replay: Replay, num_rows: int, key: Key[Array, ""]) -> Any:
    """Draws rows [num_rows, ...] uniformly with replacement from those that hold data."""
    index = jax.random.randint(key, (num_rows,), 0, replay.size)
    return jax.tree.map(lambda rows: rows[index], replay.rows)
