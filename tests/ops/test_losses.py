"""Loss terms against NumPy, and their gradients against written derivations."""

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax.ops import losses

LOGITS = np.array([0.3, -1.2, 2.0, 0.0], np.float32)
PROBABILITIES = np.exp(LOGITS) / np.exp(LOGITS).sum()


def test_policy_gradient_is_one_hot_minus_probabilities_times_the_advantage():
    value, gradient = jax.value_and_grad(losses.policy_gradient)(
        jnp.asarray(LOGITS), jnp.int32(1), jnp.float32(-0.7)
    )
    np.testing.assert_allclose(value, 0.7 * np.log(PROBABILITIES[1]), rtol=1e-5)
    np.testing.assert_allclose(gradient, 0.7 * (np.eye(4)[1] - PROBABILITIES), rtol=1e-5)


def test_no_gradient_flows_through_advantage_or_return():
    through_advantage = jax.grad(losses.policy_gradient, argnums=2)
    assert through_advantage(jnp.asarray(LOGITS), jnp.int32(0), jnp.float32(1.0)) == 0.0
    by_value, by_return = jax.grad(losses.value_error, argnums=(0, 1))(
        jnp.float32(1.0), jnp.float32(3.0)
    )
    assert (by_value, by_return) == (-4.0, 0.0)


def test_entropy_equals_the_sum_and_survives_certainty():
    expected = -(PROBABILITIES * np.log(PROBABILITIES)).sum()
    np.testing.assert_allclose(losses.entropy(jnp.asarray(LOGITS)), expected, rtol=1e-5)
    np.testing.assert_allclose(losses.entropy(jnp.zeros(4)), np.log(4), rtol=1e-6)
    certain = jnp.array([200.0, 0.0, 0.0, 0.0])
    assert losses.entropy(certain) == 0.0
    assert np.isfinite(jax.grad(losses.entropy)(certain)).all()


def test_batched_equals_looped():
    logits = jax.random.normal(jax.random.key(0), (5, 4))
    action = jnp.arange(5, dtype=jnp.int32) % 4
    advantage = jnp.linspace(-1.0, 1.0, 5)
    batched = jax.jit(jax.vmap(losses.policy_gradient))(logits, action, advantage)
    looped = [losses.policy_gradient(*row) for row in zip(logits, action, advantage, strict=True)]
    np.testing.assert_allclose(batched, jnp.stack(looped), rtol=1e-5)
