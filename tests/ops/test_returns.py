"""Returns against plain NumPy loops, and identities between them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.ops import returns


def trajectory(seed: int, length: int):
    """Draws rewards, discounts with zeros among them, values and lambdas with zeros among them."""
    rng = np.random.default_rng(seed)
    discount = 0.9 * (rng.random(length) > 0.2)
    weight = rng.random(length) * (rng.random(length) > 0.2)
    columns = (rng.normal(size=length), discount, rng.normal(size=length), weight)
    return tuple(column.astype(np.float32) for column in columns)


def looped_lambda_returns(reward, discount, value, weight):
    """Follows the definition, from the last step backwards."""
    expected = np.zeros_like(reward)
    following = value[-1]
    for t in reversed(range(len(reward))):
        following = reward[t] + discount[t] * ((1 - weight[t]) * value[t] + weight[t] * following)
        expected[t] = following
    return expected


@pytest.mark.parametrize("length", [1, 2, 13])
def test_lambda_returns_follow_the_loop_eager_compiled_and_batched(length):
    rows = [trajectory(seed, length) for seed in range(3)]
    expected = np.stack([looped_lambda_returns(*row) for row in rows])
    for row, row_expected in zip(rows, expected, strict=True):
        inputs = tuple(jnp.asarray(column) for column in row)
        np.testing.assert_allclose(returns.lambda_returns(*inputs), row_expected, rtol=1e-5)
        compiled = jax.jit(returns.lambda_returns)(*inputs)
        np.testing.assert_allclose(compiled, row_expected, rtol=1e-5)
    batch = [jnp.asarray(np.stack(columns)) for columns in zip(*rows, strict=True)]
    np.testing.assert_allclose(jax.vmap(returns.lambda_returns)(*batch), expected, rtol=1e-5)


def discounted(reward, discount):
    """Returns without a value, those of the paper."""
    return returns.lambda_returns(reward, discount, jnp.zeros(len(reward)), jnp.ones(len(reward)))


def test_returns_without_a_value_sum_powers_of_the_discount():
    reward, *_ = trajectory(0, 7)
    expected = [sum(0.9**n * r for n, r in enumerate(reward[t:])) for t in range(7)]
    actual = discounted(jnp.asarray(reward), jnp.full(7, 0.9))
    np.testing.assert_allclose(actual, expected, rtol=1e-5)


def test_nothing_flows_back_over_a_terminal_step():
    reward = jnp.array([0.0, 1.0, 5.0])
    discount = jnp.array([0.5, 0.0, 0.5])
    np.testing.assert_allclose(discounted(reward, discount), [0.5, 1.0, 5.0])


def test_a_time_limit_is_replaced_by_its_value():
    reward = jnp.array([0.0, 0.0, 5.0])
    value = jnp.array([9.0, 2.0, 4.0])
    cut = returns.lambda_returns(reward, jnp.full(3, 0.5), value, jnp.array([1.0, 0.0, 1.0]))
    np.testing.assert_allclose(cut, [0.5, 1.0, 7.0])


def test_lambda_zero_is_the_one_step_target():
    reward, discount, value, _ = (jnp.asarray(column) for column in trajectory(1, 5))
    actual = returns.lambda_returns(reward, discount, value, jnp.zeros(5))
    np.testing.assert_allclose(actual, reward + discount * value, rtol=1e-6)
