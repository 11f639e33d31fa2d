"""Formulas against the table of an independent derivation, exact fractions."""

from fractions import Fraction

import numpy as np
import pytest

from eihrl_jax.theory import bounds, gaussians

PUBLISHED_HIERARCHY = [
    # nu, k, gamma, r_max; printed, derived
    (0.1, 1, 0.5, 1.0, 0.2, 0.2),
    (0.2, 2, 0.9, 1.0, 3.296398891967, 5.540166204986),
    (0.2, 5, 0.9, 1.0, 1.573085592464, 2.981542342921),
    (0.1, 25, 0.99, 1.0, 6.413956495518, 25.322431359590),
    (1.0, 25, 0.99, 1.0, 64.139564955184, 253.224313595897),
    (0.05, 10, 0.99, 2.5, 12.718777702627, 68.359895114816),
    (0.5, 50, 0.95, 1.0, 13.564564866842, 14.670834959418),
]
PUBLISHED_SUBGOAL = [
    # lipschitz, max_displacement, epsilon, k, gamma, r_max; printed, with the factor k
    (0.01, 1.0, 0.1, 25, 0.99, 1.0, 1.554912427037, 6.138826047748),
    (0.01, 1.0, 0.0, 25, 0.99, 1.0, 1.282791299104, 5.064486271918),
    (0.02, 3.0, 0.5, 25, 0.99, 1.0, 10.417959073952, 41.130315389806),
    (0.1, 1.0, 0.1, 1, 0.9, 2.0, 24.242640687119, 24.242640687119),
    (0.05, 2.0, 0.3, 10, 0.95, 1.0, 3.775304981375, 8.186953095834),
]
VALUE_GAP = [
    # delta, k, gamma; discounted sharp and linear, undiscounted sharp and linear
    (0.01, 25, 0.99, 4.348641850669, 4.500882700946, 4.893181719572, 5.064486271918),
    (0.1, 25, 0.99, 33.337692065352, 45.008827009456, 37.512260376599, 50.644862719179),
    (0.5, 25, 0.99, 81.821099369596, 225.044135047282, 92.066792681242, 253.224313595897),
    (1.0, 25, 0.99, 100.0, 450.088270094564, 112.522067523641, 506.448627191793),
    (0.1, 1, 0.5, 0.363636363636, 0.4, 0.363636363636, 0.4),
    (0.1, 2, 0.9, 3.690036900369, 5.263157894737, 3.884249368809, 5.540166204986),
    (0.2, 5, 0.9, 3.790693090325, 4.883885619399, 4.628327867848, 5.963084685843),
    (0.3, 10, 0.95, 10.329082102044, 14.952784312146, 12.870711401192, 18.632146557130),
]


def close(expected, digits):
    """What equals a rounded number to all its digits after the point."""
    return pytest.approx(expected, rel=1e-13, abs=0.51 * 10.0**-digits)


@pytest.mark.parametrize(("nu", "k", "gamma", "r_max", "printed", "derived"), PUBLISHED_HIERARCHY)
def test_published_hierarchy_bound(nu, k, gamma, r_max, printed, derived):
    bound = bounds.published_hierarchy_bound
    assert bound(nu, k, gamma, r_max=r_max) == close(printed, 12)
    assert bound(nu, k, gamma, r_max=r_max, variant="derived") == close(derived, 12)


@pytest.mark.parametrize("row", PUBLISHED_SUBGOAL)
def test_published_subgoal_bound(row):
    *inputs, r_max, printed, derived = row
    bound = bounds.published_subgoal_bound
    assert bound(*inputs, r_max=r_max) == close(printed, 12)
    assert bound(*inputs, r_max=r_max, variant="derived") == close(derived, 12)


@pytest.mark.parametrize("row", VALUE_GAP)
def test_value_gap_bound(row):
    inputs, expected = row[:3], iter(row[3:])
    for segment_reward in ("discounted", "undiscounted"):
        for form in ("sharp", "linear"):
            found = bounds.value_gap_bound(*inputs, segment_reward=segment_reward, form=form)
            assert found == close(next(expected), 12)


def test_a_known_span_of_the_return_takes_the_place_of_the_rewards():
    delta = np.array([0.01, 0.05, 0.1, 0.5])
    expected = [0.043486418507, 0.191519729630, 0.333376920654, 0.818210993696]
    for rewards in ("discounted", "undiscounted"):
        found = bounds.value_gap_bound(
            delta, 25, 0.99, value_span=1.0, reward_span=7.0, segment_reward=rewards
        )
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.51e-12)


@pytest.mark.parametrize(
    ("eta", "rho", "k", "gamma", "expected"),
    [
        (0.1, 0.0, 25, 0.99, 25.930768962),
        (0.1, 0.5, 25, 0.99, 27.597653565),
        (1.0, 0.0, 1, 0.5, 1.0),
        (0.05, 0.2, 10, 0.95, 1.852358790),
    ],
)
def test_endpoint_value_gap_bound(eta, rho, k, gamma, expected):
    assert bounds.endpoint_value_gap_bound(eta, rho, k, gamma) == close(expected, 9)


@pytest.mark.parametrize(
    ("rho", "w", "slope", "k", "gamma", "expected"),
    [
        (0.0, 0.1, 2.0, 25, 0.99, 0.700176540),
        (0.05, 0.1, 2.0, 25, 0.99, 0.925220675),
        (0.1, 0.25, 1.0, 1, 0.9, 3.25),
    ],
)
def test_wasserstein_value_gap_bound(rho, w, slope, k, gamma, expected):
    found = bounds.wasserstein_value_gap_bound(w, slope, k, gamma, reward_gap=rho)
    assert found == close(expected, 9)


@pytest.mark.parametrize(
    ("bias", "std", "k", "gamma", "slope", "length", "expected"),
    [
        (0.0, 0.1, 25, 0.99, 1.0, 0.125331413732, 2.538956897134),
        (0.1, 0.1, 25, 0.99, 1.0, 0.154857246055, 3.137089587013),
        (0.5, 0.3, 25, 0.99, 0.2, 0.600362775465, 2.432423227611),
        (1.0, 1.0, 1, 0.9, 1.0, 1.548572460551, 154.857246055115),
    ],
)
def test_displacement_value_gap_bound(bias, std, k, gamma, slope, length, expected):
    assert gaussians.rician_mean(bias, std) == close(length, 12)
    assert bounds.displacement_value_gap_bound(bias, std, slope, k, gamma) == close(expected, 12)


def exact(delta, eta, rho, k, gamma, span):
    """Evaluates the bounds in exact fractions: the formulas of Theorem 1 and of the paper."""
    delta, eta, rho, gamma, span = (Fraction(x) for x in (delta, eta, rho, gamma, span))
    kept = gamma**k
    total = sum(gamma**i for i in range(k)) * span / (1 - kept)
    options = {"reward_span": float(span)}
    return {
        ("value_gap_bound", delta): (options, total * delta / (1 - kept * (1 - delta))),
        ("value_gap_bound", delta, "linear"): (
            {**options, "form": "linear"},
            total * delta / (1 - kept),
        ),
        ("value_gap_bound", delta, "undiscounted"): (
            {**options, "segment_reward": "undiscounted"},
            k * span / (1 - kept) * delta / (1 - kept * (1 - delta)),
        ),
        ("endpoint_value_gap_bound", eta, rho): (
            options,
            (rho + kept * eta * total) / (1 - kept * (1 - eta)),
        ),
        ("optimal_value_gap_bound", delta, eta): (
            options,
            min(
                total,
                total * delta / (1 - kept * (1 - delta)) + total * eta / (1 - kept * (1 - eta)),
            ),
        ),
        ("wasserstein_value_gap_bound", eta, span): (
            {"reward_gap": float(rho)},
            (rho + kept * span * eta) / (1 - kept),
        ),
        ("displacement_value_gap_bound", eta, Fraction(0), span): (
            {},
            span * eta / (1 - kept) ** 2,
        ),
        ("published_hierarchy_bound", eta): (
            {"r_max": float(span)},
            eta * span / (2 * (1 - kept)) * (k + kept / (1 - kept)),
        ),
        ("published_hierarchy_bound", eta, "derived"): (
            {"r_max": float(span), "variant": "derived"},
            eta * k * span / (2 * (1 - kept)) * (1 + kept / (1 - kept)),
        ),
    }


@pytest.mark.parametrize(
    "gamma", [0.0, 1e-3, 0.5, 0.5000001, 0.97, 1 - 1e-6, 1 - 1e-12, 1 - 2**-53]
)
@pytest.mark.parametrize("k", [1, 2, 25])
@pytest.mark.parametrize(("delta", "eta"), [(0.3, 0.2), (1e-9, 1e-14), (0.0, 1.0), (1.0, 0.0)])
def test_formulas_lose_no_digits(k, gamma, delta, eta):
    for (name, *inputs), (options, expected) in exact(delta, eta, 0.05, k, gamma, 2.5).items():
        numbers = [float(value) for value in inputs if isinstance(value, Fraction)]
        found = getattr(bounds, name)(*numbers, k, gamma, **options)
        assert found == pytest.approx(float(expected), rel=1e-13, abs=0.0), (name, inputs, options)


def test_the_two_optimal_bounds_add_up_to_no_more_than_the_span_of_the_return():
    assert bounds.optimal_value_gap_bound(0.05, 0.1, 1, 0.5) == pytest.approx(2 / 21 * 2 + 4 / 11)
    assert bounds.optimal_value_gap_bound(0.9, 0.9, 1, 0.5, value_span=3.0) == 3.0


@pytest.mark.parametrize("num", range(1, 8))
def test_maximum_norms_bound_total_variations_by_half_the_number_of_outcomes(num):
    rng = np.random.default_rng(num)
    laws = rng.dirichlet(np.full(num, 0.5), (2, 500))
    apart = np.abs(laws[0] - laws[1])
    bound = bounds.max_norm_to_total_variation(np.minimum(apart.max(-1), 1.0), num)
    assert (apart.sum(-1) / 2.0 <= bound + 1e-12).all()
    step = 0.4 / num  # up for half of the outcomes, down for as many: attained
    moved = np.array([step] * (num // 2) + [-step] * (num // 2))
    attained = np.abs(moved).sum() / 2.0
    assert bounds.max_norm_to_total_variation(step, num) == pytest.approx(attained, abs=1e-15)
    assert bounds.max_norm_to_total_variation(1.0, 10) == 1.0


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
        (gaussians.total_variation, ([0, 1], 1)),
        (gaussians.scale_total_variation, ([2, 1], 1)),
        (gaussians.rician_mean, ([0, 1], 1)),
        (gaussians.rayleigh_cdf, ([0, 1], 1)),
        (gaussians.rayleigh_quantile, ([0, 0.5], 1)),
    ],
)
def test_lists_of_numbers_give_float64_arrays(function, inputs):
    found = function(*inputs)
    assert (found.shape, found.dtype) == ((2,), np.float64)
