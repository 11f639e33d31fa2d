"""Wrong input: the message names argument, value and limit."""

import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.config.limits import Range
from eihrl_jax.theory import arguments, bounds, fixtures, gaussians, mismatch, tabular

CHAIN = fixtures.keep_or_fall(0.1)
chain_with = CHAIN.replace
P, R, FLAT, LOW, HIGH = CHAIN.transition, CHAIN.reward, CHAIN.flat, CHAIN.low, CHAIN.high

OUT_OF_RANGE = [
    # function and arguments; what the message must name
    (lambda: bounds.value_gap_bound(1.1, 1, 0.5), "total_variation = 1.1 .* at most 1.0"),
    (lambda: bounds.value_gap_bound(-0.1, 1, 0.5), "total_variation = -0.1 .* at least 0.0"),
    (lambda: bounds.value_gap_bound(np.nan, 1, 0.5), "total_variation = nan .* at most 1.0"),
    (lambda: bounds.value_gap_bound([0.1, 2.0], 1, 0.5), "total_variation = 2.0"),
    (lambda: bounds.value_gap_bound(jnp.array([0.1, 2.0]), 1, 0.5), "total_variation = 2.0"),
    (lambda: bounds.value_gap_bound(0.1, 1, 1.0), "gamma = 1.0 .* smaller than 1.0"),
    (lambda: bounds.value_gap_bound(0.1, 1, -0.5), "gamma = -0.5 .* at least 0.0"),
    (lambda: bounds.value_gap_bound(0.1, 1, np.nan), "gamma = nan .* smaller than 1.0"),
    (lambda: bounds.value_gap_bound(0.1, 0, 0.5), "k = 0.0 .* at least 1"),
    (lambda: bounds.value_gap_bound(0.1, np.array([3, -2]), 0.5), "k = -2.0 .* at least 1"),
    (lambda: bounds.value_gap_bound(0.1, 1, 0.5, reward_span=-1.0), "reward_span = -1.0 .* 0.0"),
    (lambda: bounds.value_gap_bound(0.1, 1, 0.5, value_span=np.inf), "value_span = inf"),
    (lambda: bounds.endpoint_value_gap_bound(0.1, -0.2, 1, 0.5), "reward_gap = -0.2 .* 0.0"),
    (lambda: bounds.endpoint_value_gap_bound(1.2, 0.2, 1, 0.5), "total_variation = 1.2 .* 1.0"),
    (lambda: bounds.optimal_value_gap_bound(0.5, 1.5, 1, 0.5), "perturbation = 1.5 .* 1.0"),
    (lambda: bounds.wasserstein_value_gap_bound(-1, 1, 1, 0.5), "wasserstein = -1.0 .* 0.0"),
    (lambda: bounds.wasserstein_value_gap_bound(1, -1, 1, 0.5), "value_lipschitz = -1.0 .* 0.0"),
    (lambda: bounds.displacement_value_gap_bound(1, -1, 1, 1, 0.5), "std = -1.0 .* 0.0"),
    (lambda: bounds.displacement_value_gap_bound(1, 1, -1, 1, 0.5), "reward_lipschitz = -1.0"),
    (lambda: bounds.published_hierarchy_bound(2.1, 1, 0.5), "mismatch = 2.1 .* at most 2.0"),
    (lambda: bounds.published_hierarchy_bound(1, 1, 0.5, r_max=-1), "r_max = -1.0 .* 0.0"),
    (lambda: bounds.published_subgoal_bound(-1, 1, 1, 1, 0.5), "lipschitz = -1.0 .* 0.0"),
    (lambda: bounds.published_subgoal_bound(1, -1, 1, 1, 0.5), "max_displacement = -1.0 .* 0.0"),
    (lambda: bounds.published_subgoal_bound(1, 1, -1, 1, 0.5), "epsilon = -1.0 .* 0.0"),
    (lambda: bounds.max_norm_to_total_variation(1.5, 2), "mismatch = 1.5 .* at most 1.0"),
    (lambda: bounds.max_norm_to_total_variation(0.5, 0), "outcomes = 0.0 .* at least 1"),
    (lambda: gaussians.total_variation(1.0, 0.0), "std = 0.0 .* greater than 0"),
    (lambda: gaussians.total_variation(-1.0, 1.0), "mean_shift = -1.0 .* 0.0"),
    (lambda: gaussians.scale_total_variation(1.0, [1, -1]), "std_b = -1.0 .* than 0"),
    (lambda: gaussians.rayleigh_cdf(-1.0, 1.0), "radius = -1.0 .* 0.0"),
    (lambda: gaussians.rayleigh_quantile(1.0, 1.0), "level = 1.0 .* smaller than 1.0"),
    (lambda: gaussians.rayleigh_quantile(0.5, 1.0, segments=0), "segments = 0.0 .* at least 1"),
    (lambda: arguments.real("x", np.inf, Range()), "x = inf must be finite"),
    (lambda: fixtures.keep_or_fall(1.5), "delta = 1.5 .* at most 1.0"),
    (lambda: fixtures.disjoint_uniform(0), "num = 0 must be at least 1"),
    (lambda: fixtures.random_mdps(0, 3, num_subgoals=0), "num_subgoals = 0 must be at least 1"),
    (lambda: fixtures.random_mdps(0, 3, closeness=-1.0), "closeness = -1.0 .* at least 0.0"),
    (lambda: tabular.k_step_model(CHAIN, 0, 0.9), "k = 0 must be at least 1"),
    (lambda: tabular.optimal_value(CHAIN, 1.0), "gamma = 1.0 .* smaller than 1.0"),
    (lambda: tabular.policy_value(CHAIN, float("nan")), "gamma = nan"),
    (lambda: tabular.hierarchical_value(CHAIN, 2, -0.1), "gamma = -0.1"),
    (
        lambda: mismatch.path_total_variation(CHAIN, 3, max_paths=63),
        "k = 3 makes 64 paths, at most 63",
    ),
    (lambda: mismatch.mismatch(CHAIN, 10, 0.9), "k = 10 makes 1048576 paths"),
    (lambda: mismatch.check_bounds(chain_with(reward=R - 1), 1, 0.9), "reward = -1.0 .* 0"),
]
WRONG_TABLES = [
    (
        lambda: tabular.policy_value(chain_with(flat=FLAT * 0.9), 0.9),
        "flat: a row sums to 0.9.* 1e-6",
    ),
    (
        lambda: tabular.policy_value(chain_with(transition=P * (1 + 2e-6)), 0.9),
        "transition: a row .* 1e-6",
    ),
    (
        lambda: tabular.policy_value(chain_with(flat=[[1.5, -0.5]] * 2), 0.9),
        "flat = -0.5 .* at least 0",
    ),
    (
        lambda: tabular.policy_value(chain_with(flat=[[np.nan, 1.0]] * 2), 0.9),
        "flat holds nan.* finite",
    ),
    (lambda: tabular.policy_value(chain_with(reward=R + np.inf), 0.9), "reward holds inf.* finite"),
    (
        lambda: tabular.policy_value(chain_with(flat=FLAT[:, :1]), 0.9),
        r"flat has shape \(2, 1\).* 2, 2",
    ),
    (
        lambda: tabular.policy_value(chain_with(reward=R[:1]), 0.9),
        r"reward has shape \(1, 2\).* 2, 2",
    ),
    (
        lambda: tabular.policy_value(chain_with(transition=P[0]), 0.9),
        r"transition has shape \(2, 2\)",
    ),
    (
        lambda: tabular.policy_value(chain_with(transition=np.full((2, 2, 3), 1 / 3)), 0.9),
        r"transition has shape \(2, 2, 3\), .* equal S",
    ),
    (lambda: tabular.optimal_value(chain_with(reward=1.0), 0.9), r"reward has shape \(\).* 2, 2"),
    (
        lambda: tabular.option_models(chain_with(transition=P[0]), 2, 0.9),
        r"transition has shape \(2, 2\)",
    ),
    (lambda: tabular.option_models(chain_with(reward=R[0]), 2, 0.9), r"reward has shape \(2,\)"),
    (
        lambda: tabular.option_models(chain_with(low=LOW[0]), 2, 0.9),
        r"low has shape \(2, 2\).* any, 2, 2",
    ),
    (lambda: tabular.option_models(chain_with(low=LOW * 0.9), 2, 0.9), "low: a row sums to 0.9"),
    (
        lambda: tabular.hierarchical_value(chain_with(high=HIGH[:, :1]), 2, 0.9),
        r"high has shape \(2, 1\).* 2, 2",
    ),
    (
        lambda: tabular.hierarchical_value(chain_with(high=HIGH - 1), 2, 0.9),
        "high = -.* at least 0",
    ),
    (lambda: mismatch.agreement(chain_with(low=LOW[..., :1]), 2), r"low has shape \(2, 2, 1\)"),
    (
        lambda: mismatch.path_total_variation(chain_with(transition=np.full((2, 2, 3), 1 / 3)), 2),
        r"transition has shape \(2, 2, 3\), .* equal S",
    ),
    (
        lambda: mismatch.path_total_variation(chain_with(high=HIGH / 2), 2),
        "high: a row sums to 0.5",
    ),
]
WRONG_TYPES = [
    (lambda: bounds.value_gap_bound(0.1, 2.5, 0.5), "k = 2.5 must be an integer"),
    (lambda: bounds.value_gap_bound(0.1, "3", 0.5), "k = '3' must be an integer"),
    (lambda: bounds.value_gap_bound(0.1, 3.0, 0.5), "k = 3.0 must be an integer"),
    (lambda: bounds.value_gap_bound(0.1, True, 0.5), "k = True must be an integer"),
    (lambda: bounds.value_gap_bound(0.1, jnp.array(2.5), 0.5), "k = .*2.5.* an integer"),
    (lambda: bounds.value_gap_bound("0.1", 3, 0.5), "total_variation = '0.1' .* real number"),
    (lambda: bounds.value_gap_bound(0.1j, 3, 0.5), "total_variation = 0.1j .* real number"),
    (lambda: bounds.value_gap_bound(None, 3, 0.5), "total_variation = None .* real number"),
    (lambda: bounds.value_gap_bound(0.1, 3, jnp.array(0.1j)), "gamma = .* real number"),
    (lambda: gaussians.rayleigh_quantile(0.5, 1.0, segments=2.5), "segments = 2.5 .* integer"),
    (lambda: arguments.scalar_count("k", 2.5, Range(1)), "k = 2.5 must be an integer"),
    (lambda: arguments.scalar_count("k", "3", Range(1)), "k = '3' must be an integer"),
    (lambda: arguments.scalar_count("k", True, Range(1)), "k = True must be an integer"),
]


@pytest.mark.parametrize(("call", "message"), OUT_OF_RANGE + WRONG_TABLES)
def test_a_wrong_value_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(("call", "message"), WRONG_TYPES)
def test_a_wrong_type_is_named(call, message):
    with pytest.raises(TypeError, match=message):
        call()


def test_an_unknown_word_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match="form = 'round' must be one of sharp, linear"):
        bounds.value_gap_bound(0.1, 1, 0.5, form="round")


def test_rows_may_miss_one_by_rounding_and_are_normalised():
    almost = FLAT * (1.0 + 9e-7)
    np.testing.assert_array_equal(arguments.probabilities("flat", almost, (2, 2)), FLAT)
    found = tabular.policy_value(chain_with(flat=almost), 0.9)
    np.testing.assert_allclose(found, [10.0, 0.0], rtol=1e-14)
