"""One step of an Optax optimiser, as all learners of the baselines take it."""

from typing import Any

import jax
import optax
from jaxtyping import Array, Float


def step(
    optimizer: optax.GradientTransformation,
    grads: Any,
    opt_state: optax.OptState,
    params: Any,
    rate: Float[Array, ""] | float = 1.0,
) -> tuple[Any, optax.OptState]:
    """Returns parameters and the optimiser's state after one step of `rate` times its length."""
    with jax.numpy_dtype_promotion("standard"):  # Optax takes integer powers of floats.
        updates, opt_state = optimizer.update(grads, opt_state, params)
    updates = jax.tree.map(lambda update: rate * update, updates)
    return optax.apply_updates(params, updates), opt_state
