"""Small MDPs by hand: where Theorem 1 is an equality, and where the published bounds fail."""

from fractions import Fraction

import numpy as np
import pytest

from eihrl_jax.theory import bounds, fixtures, mismatch, tabular
from eihrl_jax.theory import problem as problem_lib

READINGS = ("literal", "endpoint max", "endpoint L1", "path max", "path L1")


def failing(result):
    """Names the bounds that don't hold."""
    return {name for name, holds in result.holds.items() if not holds}


def both(*readings):
    """Names the published bounds with these readings."""
    return {f"{variant}, {name}" for variant in ("printed", "derived") for name in readings}


def near(value):
    """What equals an exact fraction up to rounding."""
    return pytest.approx(float(value), rel=1e-12, abs=1e-14)


def test_one_fall_in_ten_breaks_every_maximum_norm():
    problem = fixtures.keep_or_fall(0.1, per_step=True)
    result, nu = mismatch.check_bounds(problem, 1, 0.5), mismatch.mismatch(problem, 1, 0.5)
    assert result.gap == near(Fraction(4, 11))
    for reading in (nu.literal, nu.endpoint_max, nu.path_max, nu.path_total_variation):
        assert reading == near(Fraction(1, 10))
    for name in both("literal", "endpoint max", "path max"):
        assert result.bounds[name] == near(Fraction(1, 5))
    for name in both("endpoint L1", "path L1"):
        assert result.bounds[name] == near(Fraction(2, 5))
    for name in ("path", "agreement", "one step"):
        assert result.bounds[name] == near(Fraction(4, 11))
    assert failing(result) == both("literal", "endpoint max", "path max")


@pytest.mark.parametrize("num", [1, 2, 3, 50])
def test_disjoint_ends_are_a_maximum_norm_of_one_in_many(num):
    problem = fixtures.disjoint_uniform(num)
    result, nu = mismatch.check_bounds(problem, 1, 0.5), mismatch.mismatch(problem, 1, 0.5)
    assert result.gap == near(1)
    assert (nu.reward_gap, nu.endpoint_total_variation) == (near(0), near(1))
    for reading in (nu.literal, nu.endpoint_max, nu.path_max):
        assert reading == near(Fraction(1, num))
    for name in both("literal", "endpoint max", "path max"):
        assert result.bounds[name] == near(Fraction(2, num))
    assert result.bounds["endpoint"] == near(1)
    is_broken = num > 2
    assert failing(result) == (both("literal", "endpoint max", "path max") if is_broken else set())


@pytest.mark.parametrize(("k", "gamma"), [(1, 0.5), (3, 0.9)])
def test_equal_ends_may_hide_a_loss_of_everything(k, gamma):
    problem = fixtures.equal_endpoints()
    result, nu = mismatch.check_bounds(problem, k, gamma), mismatch.mismatch(problem, k, gamma)
    assert result.gap == near(1.0 / (1.0 - gamma))
    assert (nu.literal, nu.endpoint_max, nu.endpoint_total_variation) == (0.0, 0.0, 0.0)
    assert nu.path_total_variation == nu.path_max == 1.0
    for name in both("literal", "endpoint max", "endpoint L1"):
        assert result.bounds[name] == 0.0
    assert both("literal", "endpoint max", "endpoint L1") <= failing(result)
    for name in ("path", "agreement", "one step", "endpoint"):
        assert result.bounds[name] == near(1.0 / (1.0 - gamma))


def test_rewards_on_the_way_are_invisible_to_ends():
    # 0 leads to 1 or 2, both to 3; only 1 pays.
    transition = np.zeros((4, 2, 4))
    transition[0, 0, 1] = transition[0, 1, 2] = 1.0
    transition[1:, :, 3] = 1.0
    reward = np.zeros((4, 2))
    reward[1] = 1.0
    keep = [[1.0, 0.0]] * 4
    low, high = [[[0.0, 1.0], *keep[1:]]], [[1.0]] * 4
    result = mismatch.check_bounds(problem_lib.Problem(transition, reward, keep, low, high), 2, 0.9)
    assert result.gap == near(0.9)
    assert result.bounds["derived, endpoint L1"] == 0.0
    assert failing(result) == both("literal", "endpoint max", "endpoint L1")


def test_the_missing_factor_k_breaks_the_printed_bound_in_the_l1_norm():
    problem = fixtures.keep_or_fall(0.1)
    result = mismatch.check_bounds(problem, 2, 0.9)
    assert result.gap == near(Fraction(1000, 271))
    low_value = tabular.hierarchical_value(problem, 2, 0.9)
    np.testing.assert_allclose(low_value, [1710 / 271, 0.0], rtol=1e-12)
    assert result.bounds["path"] == near(Fraction(1000, 271))
    assert result.bounds["printed, path L1"] == near(Fraction(1190, 361))
    assert result.bounds["derived, path L1"] == near(Fraction(2000, 361))
    broken = failing(result)
    assert {"printed, path L1", "printed, endpoint L1", *both("path max", "endpoint max")} == broken


def test_the_same_without_discount_inside_segments():
    p = fixtures.keep_or_fall(0.1)
    options = {"segment_reward": "undiscounted"}
    flat = tabular.segment_value(p, 2, 0.9, **options)
    low = tabular.hierarchical_value(p, 2, 0.9, **options)
    assert np.abs(flat - low).max() == near(Fraction(20000, 5149))
    assert bounds.value_gap_bound(0.1, 2, 0.9, **options) == near(Fraction(20000, 5149))


def test_long_segments_and_rare_falls():
    p = fixtures.keep_or_fall(0.01)
    flat = tabular.policy_value(p, 0.99)
    low = tabular.hierarchical_value(p, 25, 0.99)
    assert (flat - low).max() == pytest.approx(4.348642, abs=5e-7)
    for nu, printed, derived in [(0.02, 1.282791, 5.064486), (0.01, 0.641396, 2.532243)]:
        bound = bounds.published_hierarchy_bound
        assert bound(nu, 25, 0.99) == pytest.approx(printed, abs=5e-7)
        assert bound(nu, 25, 0.99, variant="derived") == pytest.approx(derived, abs=5e-7)


def test_goals_at_equal_distances_break_the_theorem_on_subgoals():
    p = fixtures.equal_distances()
    flat = tabular.policy_value(p, 0.5)
    low = tabular.hierarchical_value(p, 1, 0.5)
    np.testing.assert_allclose(flat - low, [1.0, 0.0, 0.0], atol=1e-14)
    # Both displacements are 1, so that realised pairs allow a Lipschitz constant of 0.
    assert bounds.published_subgoal_bound(0.0, 1.0, 0.0, 1, 0.5) == 0.0


@pytest.mark.parametrize("delta", [0.0, 1e-6, 0.1, 0.7, 1.0])
@pytest.mark.parametrize("gamma", [0.0, 0.3, 0.9, 0.999])
@pytest.mark.parametrize("k", [1, 2, 5])
def test_theorem_1_is_an_equality_where_segments_keep_or_fall(k, gamma, delta):
    result = mismatch.check_bounds(fixtures.keep_or_fall(delta), k, gamma)
    exact_gamma, exact_delta = Fraction(gamma), Fraction(delta)
    kept = exact_gamma**k
    gap = exact_delta / (1 - exact_gamma) / (1 - kept * (1 - exact_delta))
    assert result.gap == pytest.approx(float(gap), rel=1e-9, abs=1e-10)
    for name in ("path", "agreement"):
        assert result.bounds[name] == pytest.approx(float(gap), rel=1e-9, abs=1e-10)
    assert not failing(result) & {"path", "path, linear", "agreement", "one step", "endpoint"}
    assert result.holds["derived, path L1"]


@pytest.mark.parametrize("k", [1, 2, 5])
@pytest.mark.parametrize("delta", [0.05, 0.6])
def test_the_one_step_bound_is_an_equality_where_steps_keep_or_fall(k, delta):
    result = mismatch.check_bounds(fixtures.keep_or_fall(delta, per_step=True), k, 0.9)
    assert result.gap == pytest.approx(10.0 * delta / (1.0 - 0.9 * (1.0 - delta)), rel=1e-12)
    assert result.bounds["one step"] == pytest.approx(result.gap, rel=1e-12)
    assert result.bounds["path"] >= result.gap * (1.0 - 1e-12)


def test_slips_in_single_steps_add_up_over_a_segment():
    problem = fixtures.keep_or_fall(0.1, per_step=True)
    result = mismatch.check_bounds(problem, 3, 0.9)
    assert mismatch.mismatch(problem, 3, 0.9).path_total_variation == near(Fraction(271, 1000))
    assert result.gap == pytest.approx(5.263157894737, abs=5.1e-13)
    assert result.bounds["one step"] == pytest.approx(5.263157894737, abs=5.1e-13)
    assert result.bounds["path"] == pytest.approx(5.783689994216, abs=5.1e-13)


@pytest.mark.parametrize(
    ("k", "limit"), [(2, 0.618034), (3, 0.722714), (5, 0.821327), (10, 0.905566), (25, 0.960915)]
)
def test_the_printed_bound_in_the_l1_norm_holds_up_to_some_discount(k, limit):
    for gamma in (limit - 1e-3, limit + 1e-3):
        delta = np.geomspace(1e-7, 1.0, 50)
        gap = delta / (1.0 - gamma) / (1.0 - gamma**k * (1.0 - delta))
        holds = gap <= bounds.published_hierarchy_bound(2.0 * delta, k, gamma)
        assert holds.all() == (gamma < limit)


@pytest.mark.parametrize("num", [1, 2, 5])
def test_neither_reading_of_an_end_bounds_the_other(num):
    # Equal policies under several subgoals: eq. 16 is 0, eq. 8 isn't.
    p = fixtures.keep_or_fall(0.0, per_step=True)
    low, high = np.repeat(p.low, num, 0), np.full((2, num), 1.0 / num)
    nu = mismatch.mismatch(p.replace(low=low, high=high), 1, 0.5)
    assert nu.endpoint_max == near(0)
    assert nu.literal == near(1.0 - 1.0 / num)
    # Uniform against all subgoals to one state of `size`.
    size = 4
    transition = np.broadcast_to(np.eye(size), (size, size, size))
    flat, low = np.full((size, size), 1.0 / size), np.zeros((num, size, size))
    low[..., 0] = 1.0
    high = np.full((size, num), 1.0 / num)
    reward = np.zeros((size, size))
    nu = mismatch.mismatch(problem_lib.Problem(transition, reward, flat, low, high), 1, 0.5)
    assert nu.endpoint_max == near(1.0 - 1.0 / size)
    assert nu.literal == near(max(1.0 / size, abs(1.0 / size - 1.0 / num)))
