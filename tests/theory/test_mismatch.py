"""Readings of nu against an enumeration of paths, and the bounds on tens of thousands of MDPs."""

import functools
import itertools

import jax
import numpy as np
import pytest
from scipy import stats

from eihrl_jax.theory import bounds, fixtures, mismatch, tabular
from eihrl_jax.theory import problem as problem_lib

CORRECTED = ("path", "path, linear", "agreement", "one step", "endpoint")
GAMMAS = (0.3, 0.9, 0.99)
SIZES = [
    # S, A, G, k, number of MDPs
    (2, 2, 1, 1, 2000),
    (2, 2, 2, 3, 1500),
    (3, 2, 2, 2, 1800),
    (3, 3, 3, 2, 1000),
    (4, 2, 2, 3, 700),
    (5, 2, 3, 2, 1200),
    (6, 3, 2, 1, 1200),
    (8, 2, 2, 2, 900),
    (8, 2, 3, 3, 50),
]


def enumerate_paths(problem, k, gamma):
    """Compares the two policies path by path, from every state."""
    num_subgoals, num_states, num_actions = problem.low.shape
    apart, greatest = np.zeros(num_states), np.zeros(num_states)
    common, per_subgoal = np.zeros((2, num_subgoals, num_states))
    ends_flat, paid_flat = np.zeros((num_states, num_states)), np.zeros(num_states)
    ends_low, paid_low = np.zeros((num_subgoals, *ends_flat.shape)), np.zeros(common.shape)
    for states in itertools.product(range(num_states), repeat=k + 1):
        for actions in itertools.product(range(num_actions), repeat=k):
            steps = list(zip(states[:-1], actions, states[1:], strict=True))
            moves = np.prod([problem.transition[step] for step in steps])
            reward = sum(gamma**i * problem.reward[s, a] for i, (s, a, _) in enumerate(steps))
            first, last = states[0], states[-1]
            p = moves * np.prod([problem.flat[s, a] for s, a, _ in steps])
            ends_flat[first, last] += p
            paid_flat[first] += p * reward
            q = 0.0
            for g in range(num_subgoals):
                low = problem.low[g]
                q_g = moves * np.prod([low[s, a] for s, a, _ in steps])
                smaller = [min(low[s, a], problem.flat[s, a]) for s, a, _ in steps]
                common[g, first] += moves * np.prod(smaller)
                per_subgoal[g, first] += abs(p - q_g) / 2.0
                ends_low[g, first, last] += q_g
                paid_low[g, first] += q_g * reward
                q += problem.high[first, g] * q_g
            apart[first] += abs(p - q) / 2.0
            greatest[first] = max(greatest[first], abs(p - q))
    weighted = problem.high.T[..., None] * ends_low
    ends = np.abs(ends_flat - weighted.sum(0))
    readings = {
        "literal": np.abs(ends_flat - weighted).max(),
        "endpoint_max": ends.max(),
        "endpoint_total_variation": ends.sum(-1).max() / 2.0,
        "path_max": greatest.max(),
        "path_total_variation": apart.max(),
        "reward_gap": np.abs(paid_flat - (problem.high.T * paid_low).sum(0)).max(),
    }
    return readings, apart, common, per_subgoal


@pytest.mark.parametrize(("num_states", "num_actions", "num_subgoals", "k"), [
    (3, 2, 2, 1),
    (4, 3, 3, 1),
    (3, 2, 3, 2),
    (2, 3, 1, 2),
    (2, 2, 2, 3),
])  # fmt: skip
def test_readings_are_sums_over_paths(num_states, num_actions, num_subgoals, k):
    problems = fixtures.random_mdps(
        k, 8, num_states=num_states, num_actions=num_actions, num_subgoals=num_subgoals
    )
    p, gamma = problems, 0.8
    together = mismatch.mismatch(p, k, gamma)
    paths = mismatch.path_total_variation(p, k)
    shared = mismatch.agreement(p, k)
    num_deterministic = 0
    for i in range(8):
        one = jax.tree.map(lambda array, i=i: array[i], problems)
        readings, apart, common, per_subgoal = enumerate_paths(one, k, gamma)
        alone = mismatch.mismatch(one, k, gamma)
        for name, expected in readings.items():
            for found in (getattr(together, name)[i], getattr(alone, name)):
                assert found == pytest.approx(expected, rel=1e-11, abs=1e-14), name
        np.testing.assert_allclose(paths[i], apart, rtol=1e-11, atol=1e-14)
        np.testing.assert_allclose(shared[i], common, rtol=1e-11, atol=1e-14)
        assert (per_subgoal <= 1.0 - shared[i] + 1e-12).all()
        if (one.flat.max(-1) == 1.0).all():
            num_deterministic += 1
            np.testing.assert_allclose(1.0 - shared[i], per_subgoal, atol=1e-12)
    assert 0 < num_deterministic < 8


def problems_of(index):
    """Draws the MDPs of one row of SIZES."""
    num_states, num_actions, num_subgoals, k, num = SIZES[index]
    problems = fixtures.random_mdps(
        index, num, num_states=num_states, num_actions=num_actions, num_subgoals=num_subgoals
    )
    return problems, k


@functools.cache
def count_violations():
    """Counts the MDPs and discounts in which a bound doesn't hold, by its name."""
    violations, total = {}, 0
    for index in range(len(SIZES)):
        p, k = problems_of(index)
        for gamma in GAMMAS:
            check = mismatch.check_bounds(p, k, gamma)
            total += check.gap.size
            for name, holds in check.holds.items():
                assert holds.shape == check.gap.shape
                violations[name] = violations.get(name, 0) + int((~holds).sum())
    return violations, total


def test_corrected_bounds_are_never_violated():
    violations, total = count_violations()
    assert sum(size[-1] for size in SIZES) >= 10_000 and total >= 30_000
    assert {name: violations[name] for name in CORRECTED} == dict.fromkeys(CORRECTED, 0)
    assert violations["derived, path L1"] == 0


@pytest.mark.parametrize("variant", ["printed", "derived"])
@pytest.mark.parametrize("reading", ["literal", "endpoint max", "endpoint L1", "path max"])
def test_published_readings_are_violated_often(variant, reading):
    violations, total = count_violations()
    assert violations[f"{variant}, {reading}"] > 0.05 * total


def test_bounds_are_ordered_and_the_gap_is_that_of_the_values():
    p, k = problems_of(2)
    for gamma in GAMMAS:
        check = mismatch.check_bounds(p, k, gamma)
        for smaller, greater in [("path", "path, linear"), ("path", "agreement")]:
            assert (check.bounds[smaller] <= check.bounds[greater] + 1e-10).all()
        nu = mismatch.mismatch(p, k, gamma)
        largest = p.reward.max((-2, -1))
        kept = gamma**k
        expected = nu.path_total_variation * k * largest / (1.0 - kept) ** 2
        np.testing.assert_allclose(check.bounds["derived, path L1"], expected, rtol=1e-12)
        expected = nu.endpoint_max * largest / (2.0 * (1.0 - kept)) * (k + kept / (1.0 - kept))
        np.testing.assert_allclose(check.bounds["printed, endpoint max"], expected, rtol=1e-12)
        held = check.gap <= expected * (1.0 + 1e-9) + 1e-10
        np.testing.assert_array_equal(check.holds["printed, endpoint max"], held)
        flat = tabular.policy_value(p, gamma)
        low = tabular.hierarchical_value(p, k, gamma)
        np.testing.assert_array_equal(check.gap, np.abs(flat - low).max(-1))


@pytest.mark.parametrize("index", range(len(SIZES)))
def test_theorem_2_bounds_optimal_values(index):
    problems, k = problems_of(index)
    num = 400
    p = jax.tree.map(lambda array: array[:num], problems)
    meant, other = p.low, np.roll(problems.low, 1, 0)[:num]
    weight = np.linspace(0.0, 0.5, len(meant))[:, None, None, None]
    executed = (1.0 - weight) * meant + weight * other
    slipping = p.replace(low=executed)
    span = np.ptp(p.reward, axis=(-2, -1))
    for gamma in GAMMAS:
        best, policy = tabular.optimal_value(p, gamma)
        value, _ = tabular.optimal_hierarchical_value(p, k, gamma)
        again, _ = tabular.optimal_hierarchical_value(slipping, k, gamma)
        assert (best >= value - 1e-10).all() and (best >= again - 1e-10).all()

        common = mismatch.agreement(p.replace(flat=policy), k)
        imitation = np.clip(1.0 - common.max(-2), 0.0, 1.0).max(-1)
        limit = bounds.value_gap_bound(imitation, k, gamma, reward_span=span)
        assert ((best - value).max(-1) <= limit + 1e-10).all()

        alone = np.ones((len(meant), meant.shape[-2], 1))
        apart = [
            mismatch.path_total_variation(
                p.replace(flat=meant[:, g], low=executed[:, [g]], high=alone), k
            )
            for g in range(meant.shape[1])
        ]
        slip = np.minimum(np.max(apart, (0, 2)), 1.0)
        limit = bounds.value_gap_bound(slip, k, gamma, reward_span=span)
        assert (np.abs(value - again).max(-1) <= limit + 1e-10).all()

        limit = bounds.optimal_value_gap_bound(imitation, slip, k, gamma, reward_span=span)
        assert ((best - again).max(-1) <= limit + 1e-10).all()


def line_world(rng, num_states=6, num_actions=3, num_subgoals=2):
    """Draws a walk on a line, and two low levels that differ a little."""
    moves = rng.dirichlet(np.ones(3), (num_states, num_actions))
    transition = np.zeros((num_states, num_actions, num_states))
    for s, (i, move) in itertools.product(range(num_states), enumerate((-1, 0, 1))):
        transition[s, :, np.clip(s + move, 0, num_states - 1)] += moves[s, :, i]
    reward = rng.random((num_states, num_actions))
    rows = rng.dirichlet(np.full(num_actions, 0.5), (2, num_subgoals, num_states))
    weight = rng.uniform(0.0, 0.3)
    world = problem_lib.Problem(
        transition,
        reward,
        flat=np.full(reward.shape, 1.0 / num_actions),
        low=rows[0],
        high=np.full((num_states, num_subgoals), 1.0 / num_subgoals),
    )
    return world, (1.0 - weight) * rows[0] + weight * rows[1]


def wasserstein_gap_and_bound(world, other_low, k, gamma):
    """Returns the gap of the optimal values on a line, and what Theorem 3 says of it."""
    values, ends, pays = [], [], []
    for problem in (world, world.replace(low=other_low)):
        values += [tabular.optimal_hierarchical_value(problem, k, gamma)[0]]
        kernel, rewards = tabular.option_models(problem, k, gamma)
        ends, pays = [*ends, kernel], [*pays, rewards]
    num_states = len(world.reward)
    places = np.arange(num_states)
    pairs = zip(ends[0].reshape(-1, num_states), ends[1].reshape(-1, num_states), strict=True)
    distance = max(stats.wasserstein_distance(places, places, *pair) for pair in pairs)
    slope = min(np.abs(np.diff(value)).max() for value in values)
    gap = np.abs(pays[0] - pays[1]).max()
    limit = bounds.wasserstein_value_gap_bound(distance, slope, k, gamma, reward_gap=gap)
    return np.abs(values[0] - values[1]).max(), limit


def test_theorem_3_bounds_values_by_how_far_apart_segments_end():
    rng = np.random.default_rng(0)
    for i in range(150):
        world, other_low = line_world(rng)
        gap, limit = wasserstein_gap_and_bound(world, other_low, 1 + i % 3, GAMMAS[i // 3 % 3])
        assert gap <= limit * (1.0 + 1e-9) + 1e-10


@pytest.mark.parametrize("delta", [0.05, 0.5])
def test_theorem_3_is_an_equality_where_one_step_falls(delta):
    stays, falls = (fixtures.keep_or_fall(share, per_step=True) for share in (0.0, delta))
    gap, limit = wasserstein_gap_and_bound(stays, falls.low, 1, 0.9)
    assert gap == pytest.approx(10.0 * delta / (1.0 - 0.9 * (1.0 - delta)), rel=1e-12)
    assert limit == pytest.approx(gap, rel=1e-12)
