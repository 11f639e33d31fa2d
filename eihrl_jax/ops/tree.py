"""Pytrees as wholes."""

from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

TreeT = TypeVar("TreeT")


def where(condition: Bool[Array, "..."], if_true: TreeT, if_false: TreeT) -> TreeT:
    """Returns one of two pytrees of the same structure, leaf by leaf with `jnp.where`."""
    return jax.tree.map(lambda new, old: jnp.where(condition, new, old), if_true, if_false)


def merge_axes(tree: TreeT, num: int) -> TreeT:
    """Returns a pytree whose `num` leading axes have become one."""
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[num:]), tree)
