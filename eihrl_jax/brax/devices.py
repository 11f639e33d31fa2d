"""What learners of Brax 0.14.2 want of JAX and no longer find there."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

TreeT = TypeVar("TreeT")

_NAME = "device_put_replicated"


@contextlib.contextmanager
def replicating() -> Iterator[None]:
    """Lets Brax's PPO and SAC train while it is open.

    They call `jax.device_put_replicated`, which JAX no longer has. While this is open there is such
    a function, unless JAX has its own; after it JAX is as it was.
    """
    if hasattr(jax, _NAME):
        yield
        return

    setattr(jax, _NAME, _replicate)
    try:
        yield
    finally:
        delattr(jax, _NAME)


def _replicate(tree: TreeT, devices: Sequence[Any]) -> TreeT:
    """Puts a copy on every device, as rows of a new leading axis, where `jax.pmap` wants them."""
    # By `pmap` itself, with the name that Brax gives its axis: what is called like this is then of
    # the same mesh as all that Brax computes, and may go into one program with it.
    copy = jax.pmap(lambda _, leaves: leaves, "i", in_axes=(0, None), devices=list(devices))
    return copy(jnp.zeros(len(devices)), tree)
