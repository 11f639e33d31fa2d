"""Functions of optimisers that all learners share: one step, a loop of steps, and metrics."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Key

from eihrl_jax import base

StateT = TypeVar("StateT")
BatchT = TypeVar("BatchT")
AuxT = TypeVar("AuxT")


class TrainState(struct.PyTreeNode):
    """Parameters, and the state of the optimiser that improves them."""

    params: base.Params
    opt_state: optax.OptState


def init(optimizer: optax.GradientTransformation, params: base.Params) -> TrainState:
    """Returns the state before the first step."""
    return TrainState(params=params, opt_state=optimizer.init(params))


def step(
    optimizer: optax.GradientTransformation,
    grads: base.Params,
    opt_state: optax.OptState,
    params: base.Params,
    rate: Float[Array, ""] | float = 1.0,
) -> tuple[base.Params, optax.OptState]:
    """Returns parameters and the optimiser's state after one step of `rate` times its length."""
    with jax.numpy_dtype_promotion("standard"):  # Optax takes integer powers of floats.
        updates, opt_state = optimizer.update(grads, opt_state, params)
    # The step is scaled, not the gradient: Adam would undo a factor of the latter.
    updates = jax.tree.map(lambda update: rate * update, updates)
    return optax.apply_updates(params, updates), opt_state


def minimise(
    optimizer: optax.GradientTransformation,
    loss_fn: Callable[[base.Params], tuple[Float[Array, ""], AuxT]],
    state: TrainState,
    rate: Float[Array, ""] | float = 1.0,
) -> tuple[TrainState, AuxT]:
    """Takes one step down a loss; returns also what `loss_fn` returns beside the loss."""
    grads, aux = jax.grad(loss_fn, has_aux=True)(state.params)
    params, opt_state = step(optimizer, grads, state.opt_state, state.params, rate)
    return TrainState(params=params, opt_state=opt_state), aux


def loop(
    update: Callable[[StateT, BatchT, Key[Array, ""]], tuple[StateT, dict[str, Array]]],
    state: StateT,
    batches: BatchT,
    key: Key[Array, ""],
) -> tuple[StateT, dict[str, Array]]:
    """Updates a learner on one batch after the other.

    All batches are drawn at once, before the loop: XLA would copy a replay into a loop that draws.

    Args:
      update: from a state, a batch and a key to a state and metrics.
      state: of the learner.
      batches: pytree with a leading axis U.
      key: consumed.

    Returns:
      The new state, and the metrics of each update.
    """
    keys = jax.random.split(key, jax.tree.leaves(batches)[0].shape[0])
    return jax.lax.scan(lambda state, xs: update(state, *xs), state, (batches, keys))


def means(name: str, metrics: dict[str, Float[Array, "*U"]]) -> dict[str, Float[Array, ""]]:
    """Returns the means of a learner's metrics, as `name/metric`; NaN doesn't count."""
    return {f"{name}/{metric}": jnp.nanmean(values) for metric, values in metrics.items()}
