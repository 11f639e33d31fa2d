"""A function of older JAX versions that the learners of Brax 0.14.2 still call."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp

_NAME = "device_put_replicated"


@contextlib.contextmanager
def replicating(begin_with: Callable[[Any], Any] = lambda state: state) -> Iterator[None]:
    """Lets Brax's PPO and SAC train while it is open.

    They call `jax.device_put_replicated`, which JAX no longer has. While this is open there is such
    a function; after it JAX is as it was.

    Args:
      begin_with: makes the state that training begins with of the one that a learner has drawn.
    """

    def replicate(tree: Any, devices: Sequence[Any]) -> Any:
        # By `pmap` itself, with the name that Brax gives its axis: what is called like this is then
        # of the same mesh as all that Brax computes, and may go into one program with it.
        copy = jax.pmap(lambda _, tree: tree, "i", in_axes=(0, None), devices=list(devices))
        return copy(jnp.zeros(len(devices)), begin_with(tree))

    before = getattr(jax, _NAME, None)
    setattr(jax, _NAME, replicate)
    try:
        yield
    finally:
        if before is None:
            delattr(jax, _NAME)
        else:
            setattr(jax, _NAME, before)
