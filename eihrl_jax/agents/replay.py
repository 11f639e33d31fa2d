"""Replay: a ring of packed rows on the device."""

import math
from collections.abc import Hashable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int, Key, PyTree

Layout: TypeAlias = tuple[Hashable, tuple[tuple[tuple[int, ...], np.dtype], ...]]
"""Structure of a row, and the shape and type of each of its leaves."""


class Replay(struct.PyTreeNode):
    """A ring buffer of C rows. S: streams that are stored side by side, D: numbers per row.

    A stored pytree is one row of float32, so that drawing it is one contiguous copy: gathering leaf
    by leaf made an update twice as slow as soon as the replay had outgrown the caches. Streams may
    be spread over devices: what one of them adds stays where it was made.

    Attributes:
      rows: float32 [C / S, S, D].
      position: int32, where the next row goes.
      size: int32, number of rows that hold data.
      layout: what a row holds; no leaf.
    """

    rows: Float[Array, "T S D"]
    position: Int[Array, ""]
    size: Int[Array, ""]
    layout: Layout = struct.field(pytree_node=False)


def init(example: PyTree, capacity: int, num_streams: int = 1) -> Replay:
    """Returns a replay without rows.

    Args:
      example: pytree of arrays, real or abstract, of float32, bool, or integers that float32 holds
        exactly, up to 2^24 in size.
      capacity: number of rows, a multiple of `num_streams`.
      num_streams: rows that are stored side by side.
    """
    leaves, structure = jax.tree.flatten(example)
    width = sum(math.prod(leaf.shape) for leaf in leaves)
    return Replay(
        rows=jnp.zeros((capacity // num_streams, num_streams, width), jnp.float32),
        position=jnp.int32(0),
        size=jnp.int32(0),
        layout=(structure, tuple((leaf.shape, jnp.dtype(leaf.dtype)) for leaf in leaves)),
    )


def row(batch: PyTree, num_axes: int = 1) -> PyTree[jax.ShapeDtypeStruct]:
    """Returns the shapes of one row of a batch, real or abstract, as `init` takes them."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[num_axes:], leaf.dtype), batch)


def add(replay: Replay, batch: PyTree[Array | np.ndarray]) -> Replay:
    """Appends a batch of rows, a pytree with leading axis N; the oldest rows make room.

    Row i belongs to stream i modulo S; N is a multiple of S.

    Raises:
      ValueError: N doesn't divide the capacity, so that a batch could wrap around the end.
    """
    num_streams = replay.rows.shape[1]
    capacity = replay.rows.shape[0] * num_streams
    leaves = jax.tree.leaves(batch)
    num_rows = leaves[0].shape[0]
    if capacity % num_rows:
        raise ValueError(f"capacity {capacity} is no multiple of the batch's {num_rows} rows")

    # One type for all leaves of a row; `sample` gives each its own one back.
    parts = [leaf.astype(jnp.float32).reshape(num_rows, -1) for leaf in leaves]
    packed = jnp.concatenate(parts, axis=1).reshape(-1, num_streams, replay.rows.shape[-1])
    first = replay.position // num_streams
    return replay.replace(
        rows=jax.lax.dynamic_update_slice_in_dim(replay.rows, packed, first, axis=0),
        position=(replay.position + num_rows) % capacity,
        size=jnp.minimum(replay.size + num_rows, capacity),
    )


def sample(replay: Replay, shape: tuple[int, ...], key: Key[Array, ""]) -> PyTree:
    """Draws rows uniformly with replacement from those that hold data.

    Returns:
      A pytree like the stored ones, with leading axes `shape`.
    """
    index = jax.random.randint(key, shape, 0, replay.size)
    # Without the barrier XLA would gather anew for every element that is computed from a row.
    place = jnp.divmod(index, replay.rows.shape[1])
    rows = jax.lax.optimization_barrier(replay.rows[place])

    structure, kinds = replay.layout
    leaves, start = [], 0
    for leaf_shape, dtype in kinds:
        end = start + math.prod(leaf_shape)
        leaves.append(rows[..., start:end].reshape(*shape, *leaf_shape).astype(dtype))
        start = end
    return jax.tree.unflatten(structure, leaves)
