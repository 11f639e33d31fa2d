"""The formulas under JAX: compiled, differentiated, in its precision; NumPy's shapes and types."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.theory import bounds

SMOOTH = {
    # function of numbers, and points inside its domain
    "value_gap": (
        lambda delta, gamma, span: bounds.value_gap_bound(delta, 3, gamma, reward_span=span),
        [(0.2, 0.9, 2.0), (0.2, 0.3, 2.0), (0.9, 0.97, 0.5)],
    ),
    "value_gap, linear": (
        lambda delta, gamma: bounds.value_gap_bound(
            delta, 4, gamma, segment_reward="undiscounted", form="linear"
        ),
        [(0.2, 0.9), (0.7, 0.4)],
    ),
    "endpoint": (
        lambda eta, rho, gamma: bounds.endpoint_value_gap_bound(eta, rho, 3, gamma),
        [(0.2, 0.5, 0.9), (0.6, 0.1, 0.2)],
    ),
    "optimal": (
        lambda first, second, gamma: bounds.optimal_value_gap_bound(first, second, 5, gamma),
        [(0.01, 0.02, 0.9)],
    ),
    "wasserstein": (
        lambda w, slope, rho: bounds.wasserstein_value_gap_bound(w, slope, 3, 0.9, reward_gap=rho),
        [(0.2, 3.0, 0.1)],
    ),
    "displacement": (
        lambda bias, std, slope: bounds.displacement_value_gap_bound(bias, std, slope, 2, 0.8),
        [(0.2, 0.3, 2.0)],
    ),
    "published": (
        lambda nu, gamma: bounds.published_hierarchy_bound(nu, 25, gamma),
        [(0.2, 0.99), (1.5, 0.4)],
    ),
    "subgoal": (
        lambda slope, far, noise: bounds.published_subgoal_bound(
            slope, far, noise, 5, 0.9, variant="derived"
        ),
        [(0.02, 3.0, 0.5)],
    ),
    "max norm": (lambda nu: bounds.max_norm_to_total_variation(nu, 7), [(0.1,)]),
    "gaussian": (bounds.gaussian_total_variation, [(0.5, 1.0), (2.0, 0.5)]),
    "scale": (bounds.gaussian_scale_total_variation, [(0.5, 1.0), (1.0, 0.9), (0.01, 3.0)]),
    "rice": (bounds.rician_mean, [(0.5, 0.3), (0.2, 4.0), (2.0, 1e-5)]),
    "rayleigh": (bounds.rayleigh_cdf, [(0.5, 0.3)]),
    "quantile": (
        lambda level, std: bounds.rayleigh_quantile(level, std, segments=10),
        [(0.9, 0.3), (1e-9, 2.0)],
    ),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_gradients_are_finite_differences(name):
    function, points = SMOOTH[name]
    gradient_of = jax.jit(jax.grad(function, tuple(range(len(points[0])))))
    for point in points:
        with jax.enable_x64(True):
            gradients = [float(g) for g in gradient_of(*(jnp.asarray(value) for value in point))]
        for i, gradient in enumerate(gradients):
            step = 1e-5 * point[i]
            lower, upper = (
                float(function(*point[:i], point[i] + change, *point[i + 1 :]))
                for change in (-step, step)
            )
            rounding = 1e-9 * abs(function(*point)) / point[i]
            expected = pytest.approx((upper - lower) / (2.0 * step), rel=1e-5, abs=float(rounding))
            assert gradient == expected, (point, i)


@pytest.mark.parametrize("name", SMOOTH)
def test_jax_computes_in_the_precision_of_the_arguments(name):
    function, points = SMOOTH[name]
    compiled = jax.jit(function)
    for point in points:
        numbers = [float(np.float32(value)) for value in point]
        expected = float(function(*numbers))
        inputs = [jnp.float32(value) for value in numbers]
        # Differences from 1 amplify the rounding of float32, by less than a hundred here.
        np.testing.assert_allclose(compiled(*inputs), expected, rtol=2e-5)
        with jax.enable_x64(True):
            assert jax.eval_shape(function, *inputs).dtype == jnp.float32
            found = compiled(*(jnp.asarray(value) for value in numbers))
            assert found.dtype == jnp.float64
            np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-12)


def test_numbers_of_steps_may_be_traced_and_mapped():
    bound = jax.jit(jax.vmap(lambda k: bounds.value_gap_bound(0.1, k, 0.9)))
    expected = [bounds.value_gap_bound(0.1, k, 0.9) for k in (1, 2, 7)]
    np.testing.assert_allclose(bound(jnp.array([1, 2, 7])), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("function", "point", "expected"),
    [
        (bounds.rician_mean, (0.0, 1.0), (0.0, (np.pi / 2) ** 0.5)),
        (bounds.rician_mean, (1e-10, 1.0), (0.0, (np.pi / 2) ** 0.5)),
        (bounds.rician_mean, (1.0, 0.0), (1.0, 0.0)),
        (bounds.gaussian_scale_total_variation, (1e-9, 1.0), (0.0, 0.0)),
        (lambda gamma: bounds.value_gap_bound(0.5, 1, gamma), (0.0,), (0.5 + 0.25,)),
    ],
)
def test_gradients_are_finite_at_the_edges(function, point, expected):
    inputs = tuple(jnp.float32(value) for value in point)
    found = jax.grad(function, tuple(range(len(point))))(*inputs)
    np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("types", [np.float32, np.float64])
def test_arrays_broadcast_and_numpy_computes_in_float64(types):
    delta = np.array([0.0, 0.25, 1.0], types)[:, None, None]
    k, gamma = np.array([1, 10])[:, None], np.array([0.0, 0.5, 0.75, 0.9375], types)
    for bound in (bounds.value_gap_bound, bounds.published_hierarchy_bound):
        found = bound(delta, k, gamma)
        assert (found.shape, found.dtype) == ((3, 2, 4), np.float64)
        for index in np.ndindex(found.shape):
            x, y, z = float(delta[index[0], 0, 0]), int(k[index[1], 0]), float(gamma[index[2]])
            assert found[index] == pytest.approx(float(bound(x, y, z)), rel=1e-14, abs=0.0)


@pytest.mark.parametrize(
    ("function", "inputs"),
    [
        (bounds.endpoint_value_gap_bound, (0.2, [0.5, 1.0], 3, 0.9)),
        (bounds.optimal_value_gap_bound, (0.2, [0.5, 1.0], 3, 0.9)),
        (bounds.wasserstein_value_gap_bound, ([1, 2], 1, 3, 0)),
        (bounds.displacement_value_gap_bound, ([1, 2], 1, 1, 3, 0)),
        (bounds.published_subgoal_bound, ([1, 2], 1, 1, 3, 0)),
        (bounds.max_norm_to_total_variation, (0, [1, 2])),
        (bounds.gaussian_total_variation, ([0, 1], 1)),
        (bounds.gaussian_scale_total_variation, ([2, 1], 1)),
        (bounds.rician_mean, ([0, 1], 1)),
        (bounds.rayleigh_cdf, ([0, 1], 1)),
        (bounds.rayleigh_quantile, ([0, 0.5], 1)),
    ],
)
def test_lists_of_numbers_give_float64_arrays(function, inputs):
    found = function(*inputs)
    assert (found.shape, found.dtype) == ((2,), np.float64)
