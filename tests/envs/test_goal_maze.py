"""The maze of control steps: what it shows, pays and counts, with a stand-in for physics."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.envs import goal_maze, wrappers
from tests.envs.sled import K, Sled

TEXT = """\
#####
#S.1#
#.#.#
#2..#
#####
"""
EAST, STAY = jnp.zeros(8).at[0].set(1.0), jnp.zeros(8)


@pytest.fixture(scope="module")
def env():
    return goal_maze.GoalMaze(Sled(), mazes.parse(TEXT, num_decisions=3))


@functools.cache
def compiled(env):
    """Returns a function that rolls out any controls, compiled once for all tests."""

    def step(state, ctrl):
        following = env.step(state, ctrl)
        return following, following

    @jax.jit
    def roll(ctrls):
        first = env.reset(jax.random.key(0))
        return first, jax.lax.scan(step, first, ctrls)[1]

    return roll


def roll(env, ctrls):
    """Returns the states of an episode whose controls are given, and rest after it."""
    num = 9 * K  # the same for all, so that it is compiled once
    first, states = compiled(env)(jnp.stack([*ctrls, *[STAY] * (num - len(ctrls))]))
    states = [jax.tree.map(lambda leaf, t=t: leaf[t], states) for t in range(len(ctrls))]
    return [first, *states]


def test_it_shows_position_goal_and_time(env):
    first, *_, last = roll(env, [EAST] * (2 * K))
    np.testing.assert_allclose(first.obs.goal_xy, [3.5 * base.CELL, -1.5 * base.CELL])
    np.testing.assert_allclose(last.obs.xy - first.obs.xy, [2 * base.CELL, 0.0], atol=1e-4)
    # Goal 1 has been reached, so goal 2 is next.
    np.testing.assert_allclose(last.obs.goal_xy, [1.5 * base.CELL, -3.5 * base.CELL])
    assert last.obs.time == pytest.approx(2 * K / base.TIME_UNIT)
    assert env.side_xy == (15, 15)


def test_goals_pay_once_and_time_is_counted_in_decisions(env):
    states = roll(env, [EAST] * (2 * K) + [STAY] * K)
    assert sum(float(state.reward) for state in states) == 1.0
    assert states[-1].metrics["success"] == 0.5 and states[-1].metrics["return"] == 1.0
    assert [float(states[t].metrics["decisions"]) for t in (0, 1, K, K + 1)] == [0, 1, 1, 2]
    assert [bool(state.truncated) for state in states[-2:]] == [False, True]
    assert not any(bool(state.terminated) for state in states)


def test_an_episode_that_follows_another_by_itself_goes_on(env):
    states = roll(wrappers.AutoReset(env), [EAST] * (3 * 3 * K))
    ends = [t for t, state in enumerate(states) if state.truncated]
    assert ends == [3 * K, 6 * K, 9 * K]
    for t in ends[:2]:
        moved = states[t + K].obs.xy - states[t].obs.xy
        np.testing.assert_allclose(moved, [base.CELL, 0.0], atol=1e-4)
        assert states[t].obs.time == 0.0 and states[t + K].obs.time > 0.0


def test_the_last_goal_ends_an_episode_which_then_rests():
    env = goal_maze.GoalMaze(Sled(), mazes.parse(TEXT.replace("2", "."), num_decisions=3))
    states = roll(env, [EAST] * (3 * K))
    ends = [t for t, state in enumerate(states) if state.terminated]
    assert ends and sum(float(state.reward) for state in states) == 1.0
    at_end = states[ends[0]]
    np.testing.assert_array_equal(states[-1].obs.xy, at_end.obs.xy)
    assert states[-1].metrics["decisions"] == at_end.metrics["decisions"]
    assert states[-1].reward == 0.0 and not states[-1].truncated


def test_dense_reward_grows_on_the_way_and_stays_full_after_arrival():
    maze = mazes.parse(TEXT.replace("2", "."), num_decisions=3)
    states = roll(goal_maze.GoalMaze(Sled(), maze, reward="dense"), [EAST] * (3 * K))
    rewards = [float(state.reward) for state in states[1:]]
    way = rewards[: rewards.index(1.0)]
    assert way == sorted(way) and 0.1 < way[0] < 1.0
    assert set(rewards[len(way) :]) == {1.0}
    assert not states[-1].terminated and states[-1].truncated
    # Who has arrived can tell: the goal is where it is.
    has_arrived = [bool((state.obs.goal_xy == state.obs.xy).all()) for state in states[1:]]
    assert has_arrived == [reward == 1.0 for reward in rewards]


def test_a_broken_simulation_terminates_and_a_fall_does_not(env):
    tip, breaks = STAY.at[2].set(1.0), STAY.at[3].set(1.0)
    *_, fallen, broken = roll(env, [tip, breaks])
    assert fallen.metrics["fell"] == 1.0 and not fallen.terminated
    assert broken.metrics["broke_down"] == 1.0 and broken.terminated and broken.reward == 0.0
    assert jnp.isfinite(broken.obs.proprioception).all()
