"""The squashed Gaussian against quadrature and the change of variables written out."""

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax.ops import tanh_normal


def _density(action, mean, std):
    unsquashed = np.arctanh(action)
    normal = np.exp(-0.5 * ((unsquashed - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi))
    return normal / (1.0 - action**2)


def test_log_density_equals_change_of_variables():
    mean, std = np.array([0.4, -0.2]), np.array([0.5, 0.3])
    action, log_prob = tanh_normal.sample(
        jnp.float32(mean), jnp.float32(np.log(std)), jax.random.key(0)
    )
    expected = np.log(_density(np.asarray(action, np.float64), mean, std)).sum()
    np.testing.assert_allclose(log_prob, expected, rtol=1e-4)


def test_samples_follow_the_density():
    keys = jax.random.split(jax.random.key(1), 20_000)
    one, log_std = jnp.array([0.3]), jnp.log(jnp.array([0.7]))
    draw = jax.jit(jax.vmap(lambda key: tanh_normal.sample(one, log_std, key)[0]))
    actions = np.asarray(draw(keys))
    grid = np.linspace(-1 + 1e-6, 1 - 1e-6, 200_001)
    density = _density(grid, 0.3, 0.7)
    mean = np.trapezoid(grid * density, grid)
    variance = np.trapezoid((grid - mean) ** 2 * density, grid)
    np.testing.assert_allclose(actions.mean(), mean, atol=4 * np.sqrt(variance / 20_000))
    np.testing.assert_allclose(actions.std(), np.sqrt(variance), rtol=0.02)


def test_stays_finite_far_out():
    action, log_prob = tanh_normal.sample(jnp.array([30.0]), jnp.array([-20.0]), jax.random.key(2))
    assert np.isfinite(log_prob) and abs(float(action[0])) <= 1.0
