"""Pytrees as wholes."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

TreeT = TypeVar("TreeT")


def where(condition: Bool[Array, "..."], if_true: TreeT, if_false: TreeT) -> TreeT:
    """Returns one of two pytrees of the same structure, leaf by leaf with `jnp.where`."""
    return jax.tree.map(lambda new, old: jnp.where(condition, new, old), if_true, if_false)


def merge_axes(tree: TreeT, num: int) -> TreeT:
    """Returns a pytree whose `num` leading axes have become one."""
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[num:]), tree)


def num_bytes(tree: PyTree[Any]) -> int:
    """Returns the memory that a pytree's leaves take, arrays or what stands for their shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))
