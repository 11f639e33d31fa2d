"""Terms of the actor-critic objective for one step (paper, Algorithm 1, lines 15 and 16)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def policy_gradient(
    logits_t: Float[Array, " A"], action_t: Int[Array, ""], advantage_t: Float[Array, ""]
) -> Float[Array, ""]:
    """Computes the loss whose negative gradient is the policy gradient of one step.

    Args:
      logits_t: unnormalised log-probabilities of the actions.
      action_t: the action that was taken.
      advantage_t: R_t - V(s_t), unitless; no gradient flows through it.

    Returns:
      -log pi(a_t | s_t) * advantage_t.

    Source: paper, Algorithm 1, line 15.
    """
    # Paper: Algorithm 1, line 15, grad log pi(a_t | s_t) (R_t - V(s_t)).
    log_probability = jax.nn.log_softmax(logits_t)[action_t]
    return -log_probability * jax.lax.stop_gradient(advantage_t)


def value_error(v_t: Float[Array, ""], return_t: Float[Array, ""]) -> Float[Array, ""]:
    """Computes the squared error of the value of one step; no gradient flows through the return.

    Source: paper, Algorithm 1, line 16.
    """
    return jnp.square(jax.lax.stop_gradient(return_t) - v_t)


def entropy(logits: Float[Array, " A"]) -> Float[Array, ""]:
    """Computes the entropy, in nats, of the categorical distribution with these logits."""
    # From log-probabilities: 0 log 0 would be nan.
    log_probabilities = jax.nn.log_softmax(logits)
    return -jnp.sum(jnp.exp(log_probabilities) * log_probabilities)
