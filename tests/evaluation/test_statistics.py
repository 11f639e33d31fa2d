import math

import numpy as np
import pytest
from scipy import stats

from eihrl_jax.evaluation import statistics


@pytest.mark.parametrize(("hits", "trials"), [(0, 20), (3, 20), (250, 500), (499, 500), (20, 20)])
def test_wilson_agrees_with_scipy(hits, trials):
    expected = stats.binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    found = statistics.wilson(hits / trials, trials)
    np.testing.assert_allclose(found, (expected.low, expected.high), atol=1e-12)


def test_wilson_ends_where_the_score_test_rejects():
    low, high = statistics.wilson(0.3, 50)
    for bound in (low, high):
        score = abs(0.3 - bound) / math.sqrt(bound * (1 - bound) / 50)
        assert score == pytest.approx(stats.norm.ppf(0.975))


def test_one_goal_per_episode_makes_every_episode_a_trial():
    achieved = np.array([1] * 37 + [0] * 63)
    assert statistics.effective_trials(achieved, 1) == pytest.approx(100)
    found = statistics.success(achieved, 1)
    assert (found.rate, found.low, found.high) == (0.37, *statistics.wilson(0.37, 100))


def test_goals_reached_all_or_none_count_once_per_episode():
    achieved = np.array([3] * 30 + [0] * 70)
    assert statistics.effective_trials(achieved, 3) == pytest.approx(100)


def test_independent_goals_count_each():
    achieved = np.random.default_rng(0).binomial(3, 0.4, size=20_000)
    assert statistics.effective_trials(achieved, 3) == pytest.approx(60_000, rel=0.03)


@pytest.mark.parametrize(("each", "trials"), [(0, 10), (3, 10), (2, 30)])
def test_equal_episodes_have_a_finite_interval(each, trials):
    achieved = np.full(10, each)
    assert statistics.effective_trials(achieved, 3) == trials
    found = statistics.success(achieved, 3)
    assert found.low < found.high
    assert found.low <= found.rate <= found.high


def test_interval_of_dependent_goals_covers_the_truth():
    # One hidden success probability per episode makes an episode's three goals dependent.
    key = np.random.default_rng(1)
    chance = key.beta(0.5, 0.5, size=(400, 100))
    achieved = key.binomial(3, chance)
    found = [statistics.success(row, 3) for row in achieved]
    covered = np.mean([item.low <= 0.5 <= item.high for item in found])
    assert covered == pytest.approx(0.95, abs=0.03)


def test_block_deviation_is_that_of_five_blocks():
    fraction = np.random.default_rng(2).integers(0, 2, 500).astype(float)
    expected = fraction.reshape(5, 100).mean(1).std(ddof=1)
    assert statistics.block_std(fraction) == pytest.approx(expected)
    assert statistics.block_std(fraction[:9]) is None


def test_student_agrees_with_scipy():
    values = np.array([0.72, 0.80, 0.65, 0.91, 0.77])
    expected = stats.t.interval(0.95, 4, loc=values.mean(), scale=stats.sem(values))
    np.testing.assert_allclose(statistics.student(values), expected)


def test_runs_are_summarised_within_zero_and_one():
    spread = statistics.over_runs(np.array([0.97, 1.0, 0.99]))
    assert spread.high == 1.0
    assert spread.mean == pytest.approx(0.98666667)
    assert spread.std == pytest.approx(np.std([0.97, 1.0, 0.99], ddof=1))


def test_the_bootstrap_agrees_with_scipy_and_weighs_strata_alike():
    values = np.array([0.1, 0.4, 0.2, 0.9, 0.5, 0.3])
    expected = stats.bootstrap((values,), np.mean, method="percentile", rng=1).confidence_interval
    np.testing.assert_allclose(statistics.bootstrap([values]), expected, atol=0.02)
    # Of three values the least one is all of a resample once in 27 times, so the interval is all.
    assert statistics.bootstrap([np.array([0.0, 0.5, 1.0])]) == (0.0, 1.0)
    low, high = statistics.bootstrap([np.zeros(3), np.array([1.0] * 9)])
    assert low == pytest.approx(0.5) == high
