"""Values on small MDPs against plain loops, larger linear systems and a search of all policies."""

import itertools

import jax
import numpy as np
import pytest

from eihrl_jax.theory import fixtures, tabular

SEGMENT_REWARDS = ("discounted", "undiscounted")


def draw(seed, num_states=3, num_actions=2, num_subgoals=2):
    """One random problem."""
    problems = fixtures.random_mdps(
        seed, 1, num_states=num_states, num_actions=num_actions, num_subgoals=num_subgoals
    )
    return jax.tree.map(lambda array: array[0], problems)


def evaluate(transition, reward, actions, gamma):
    """Solves the Bellman equations of a deterministic policy."""
    rows = np.arange(len(actions))
    system = np.eye(len(actions)) - gamma * transition[rows, actions]
    return np.linalg.solve(system, reward[rows, actions])


def step_by_step(problem, high, k, gamma, segment_reward="discounted"):
    """Solves the hierarchy as one Markov chain of (state, subgoal, steps since it was drawn)."""
    num_subgoals, num_states, num_actions = problem.low.shape
    places = list(itertools.product(range(num_states), range(num_subgoals), range(k)))
    index = {place: i for i, place in enumerate(places)}
    system, rewards = np.eye(len(places)), np.zeros(len(places))
    for (s, g, i), row in index.items():
        is_last = i == k - 1
        if segment_reward == "discounted":
            discount = gamma
        else:
            discount = gamma**k if is_last else 1.0
        for a, after in itertools.product(range(num_actions), range(num_states)):
            chance = problem.low[g, s, a] * problem.transition[s, a, after]
            rewards[row] += chance * problem.reward[s, a]
            if is_last:
                for new in range(num_subgoals):
                    column = index[after, new, 0]
                    system[row, column] -= discount * chance * high[after, new]
            else:
                system[row, index[after, g, i + 1]] -= discount * chance
    value = np.linalg.solve(system, rewards)
    starts = [[value[index[s, g, 0]] for g in range(num_subgoals)] for s in range(num_states)]
    return (high * np.array(starts)).sum(-1)


@pytest.mark.parametrize("gamma", [0.0, 0.4, 0.9])
def test_values_of_a_flat_policy_are_the_limit_of_value_iteration(gamma):
    problem = draw(1)
    value = np.zeros(3)
    for _ in range(400):
        backed_up = np.zeros(3)
        for s, a in itertools.product(range(3), range(2)):
            ahead = sum(problem.transition[s, a, n] * value[n] for n in range(3))
            backed_up[s] += problem.flat[s, a] * (problem.reward[s, a] + gamma * ahead)
        value = backed_up
    found = tabular.policy_value(problem, gamma)
    np.testing.assert_allclose(found, value, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("segment_reward", SEGMENT_REWARDS)
@pytest.mark.parametrize("k", [1, 2, 3])
def test_models_of_segments_are_sums_over_paths(k, segment_reward):
    problem, gamma = draw(2), 0.7
    ends, pays = np.zeros((2, 3, 3)), np.zeros((2, 3))
    discounts = [gamma**i if segment_reward == "discounted" else 1.0 for i in range(k)]
    for g, *states in itertools.product(range(2), *[range(3)] * (k + 1)):
        for actions in itertools.product(range(2), repeat=k):
            chance, pay = 1.0, 0.0
            for i, a in enumerate(actions):
                s, after = states[i : i + 2]
                chance *= problem.low[g, s, a] * problem.transition[s, a, after]
                pay += discounts[i] * problem.reward[s, a]
            ends[g, states[0], states[-1]] += chance
            pays[g, states[0]] += chance * pay
    options = {"segment_reward": segment_reward}
    kernels, rewards = tabular.option_models(problem, k, gamma, **options)
    np.testing.assert_allclose(kernels, ends, rtol=1e-12)
    np.testing.assert_allclose(rewards, pays, rtol=1e-12)
    for g in range(2):
        kernel, reward = tabular.k_step_model(
            problem.replace(flat=problem.low[g]), k, gamma, **options
        )
        np.testing.assert_allclose(kernel, ends[g], rtol=1e-12)
        np.testing.assert_allclose(reward, pays[g], rtol=1e-12)


@pytest.mark.parametrize("segment_reward", SEGMENT_REWARDS)
@pytest.mark.parametrize("k", [1, 2, 4])
def test_values_of_a_hierarchy_are_those_of_its_markov_chain(k, segment_reward):
    problem, gamma = draw(3, num_actions=3), 0.85
    expected = step_by_step(problem, problem.high, k, gamma, segment_reward)
    found = tabular.hierarchical_value(problem, k, gamma, segment_reward=segment_reward)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    # The flat policy as the only subgoal.
    alone = problem.replace(low=problem.flat[None], high=np.ones((3, 1)))
    expected = step_by_step(alone, alone.high, k, gamma, segment_reward)
    found = tabular.segment_value(problem, k, gamma, segment_reward=segment_reward)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    if segment_reward == "discounted":
        np.testing.assert_allclose(found, tabular.policy_value(problem, gamma), rtol=1e-11)


@pytest.mark.parametrize("gamma", [0.0, 0.6, 0.99])
@pytest.mark.parametrize("seed", range(5))
def test_no_deterministic_policy_beats_the_optimal_value(seed, gamma):
    problem = draw(seed, num_states=4, num_actions=3)
    model = (problem.transition, problem.reward)
    values = [evaluate(*model, list(a), gamma) for a in itertools.product(range(3), repeat=4)]
    found, policy = tabular.optimal_value(problem, gamma)
    np.testing.assert_allclose(found, np.max(values, 0), rtol=1e-10, atol=1e-12)
    assert set(policy.flat) <= {0.0, 1.0} and (policy.sum(-1) == 1.0).all()
    chosen = evaluate(*model, policy.argmax(-1), gamma)
    np.testing.assert_allclose(chosen, found, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("segment_reward", SEGMENT_REWARDS)
@pytest.mark.parametrize(("seed", "k"), [(0, 1), (1, 2), (2, 3)])
def test_no_deterministic_high_level_beats_the_optimal_one(seed, k, segment_reward):
    problem, gamma = draw(seed, num_subgoals=3), 0.9
    values = [
        step_by_step(problem, np.eye(3)[list(subgoals)], k, gamma, segment_reward)
        for subgoals in itertools.product(range(3), repeat=3)
    ]
    found, policy = tabular.optimal_hierarchical_value(
        problem, k, gamma, segment_reward=segment_reward
    )
    np.testing.assert_allclose(found, np.max(values, 0), rtol=1e-10)
    assert set(policy.flat) <= {0.0, 1.0} and (policy.sum(-1) == 1.0).all()
    chosen = step_by_step(problem, policy, k, gamma, segment_reward)
    np.testing.assert_allclose(chosen, found, rtol=1e-10)


def test_many_mdps_at_once_are_each_alone():
    problems, k, gamma = fixtures.random_mdps(4, 5), 2, 0.9
    flat = tabular.policy_value(problems, gamma)
    hierarchical = tabular.hierarchical_value(problems, k, gamma)
    best, _ = tabular.optimal_value(problems, gamma)
    best_high, _ = tabular.optimal_hierarchical_value(problems, k, gamma)
    for i in range(5):
        one = jax.tree.map(lambda array, i=i: array[i], problems)
        alone = [
            tabular.policy_value(one, gamma),
            tabular.hierarchical_value(one, k, gamma),
            tabular.optimal_value(one, gamma)[0],
            tabular.optimal_hierarchical_value(one, k, gamma)[0],
        ]
        together = [flat[i], hierarchical[i], best[i], best_high[i]]
        np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_rewards_are_counted_from_any_zero():
    problem, gamma = draw(5), 0.8
    found = tabular.hierarchical_value(problem, 3, gamma)
    lower = tabular.hierarchical_value(problem.replace(reward=problem.reward - 2.0), 3, gamma)
    np.testing.assert_allclose(found - lower, 2.0 / (1.0 - gamma), rtol=1e-12)


def test_a_policy_stays_where_gains_are_only_rounding():
    # Equal actions: policy iteration must end, also where values are large.
    transition = np.full((3, 4, 3), 1.0 / 3.0)
    reward = np.full((3, 4), 0.1) * [[1.0], [1.0 + 1e-15], [1.0]]
    equal = draw(0, num_actions=4).replace(transition=transition, reward=reward)
    value, policy = tabular.optimal_value(equal, 1.0 - 1e-7)
    np.testing.assert_allclose(value, 1e6, rtol=1e-6)
    np.testing.assert_array_equal(policy, np.eye(4)[[0, 0, 0]])


def test_random_mdps_are_reproducible_and_of_many_kinds():
    problems = fixtures.random_mdps(0, 400, num_states=3, num_actions=3, closeness=0.5)
    again = fixtures.random_mdps(0, 400, num_states=3, num_actions=3, closeness=0.5)
    other = fixtures.random_mdps(1, 400, num_states=3, num_actions=3, closeness=0.5)
    jax.tree.map(np.testing.assert_array_equal, problems, again)
    assert not np.allclose(problems.transition, other.transition)
    for rows in (problems.transition, problems.flat, problems.low, problems.high):
        np.testing.assert_allclose(rows.sum(-1), 1.0, rtol=1e-12)
        assert (rows >= 0.0).all()
    assert ((problems.reward >= 0.0) & (problems.reward <= 1.0)).all()
    is_deterministic = (problems.flat.max(-1) == 1.0).all(-1)
    assert 0.3 < is_deterministic.mean() < 0.7
    slip = np.abs(problems.low - problems.flat[:, None]).sum(-1).max((-2, -1)) / 2.0
    assert 0.3 < (slip <= 0.3).mean() < 0.7
