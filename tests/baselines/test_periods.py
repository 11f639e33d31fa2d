"""Periods of two levels: what the upper one is paid, and what is an end to it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import mazes
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.world import World
from eihrl_jax.envs import goal_maze
from tests.envs.sled import K, Sled

TEXT = """\
######
#S1.2#
######
"""
"""The robot drives through goal 1, after a cell, to goal 2, after two more."""


@functools.cache
def two_periods(reward):
    """Returns two periods of three decisions to the east, with leading axes [2, 3 K, 1]."""
    env = goal_maze.GoalMaze(Sled(), mazes.parse(TEXT, num_decisions=9), reward=reward)
    world = World(env, 8, env.side_xy, 9 * K)
    envs = jax.vmap(env.reset)(jax.random.key(0)[None])

    def body(envs, key):
        return periods.run(
            world,
            envs,
            3 * K,
            lambda obs, key: jnp.zeros(2),
            lambda obs, subgoal, key: jnp.zeros(8).at[0].set(0.5),
            lambda subgoal, xy, next_xy: subgoal,
            key,
        )

    return jax.lax.scan(body, envs, jax.random.split(jax.random.key(1), 2))[1]


def test_a_goal_on_the_way_is_an_end_to_who_is_told_its_goal():
    period = two_periods("sparse")
    rewards = np.asarray(period.reward[:, :, 0])
    assert rewards.sum() == 2.0 and bool(period.terminated[1, -1, 0])
    arrived = np.asarray(periods.has_arrived(period, "sparse")[:, :, 0])
    for each, found in zip(rewards, arrived, strict=True):
        at = int(np.argmax(each))
        assert each[at] == 1.0
        assert found.tolist() == [False] * at + [True] * (3 * K - at)


@pytest.mark.parametrize("costs_time", [False, True])
def test_what_follows_a_goal_is_not_paid_for_it(costs_time):
    period = two_periods("sparse")
    paid = np.asarray(periods.paid(period, costs_time, "sparse")[:, :, 0])
    for each, reward in zip(paid, np.asarray(period.reward[:, :, 0]), strict=True):
        at = int(np.argmax(reward))
        assert each[:at].tolist() == [-1.0 if costs_time else 0.0] * at
        assert each[at] == (0.0 if costs_time else 1.0)
        assert not each[at + 1 :].any()


def test_dense_reward_goes_on_past_a_goal():
    period = two_periods("dense")
    assert not periods.has_arrived(period, "dense").any()
    np.testing.assert_allclose(periods.paid(period, True, "dense"), period.reward - 1.0)
