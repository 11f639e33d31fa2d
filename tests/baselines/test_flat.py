"""Flat DroQ: what it stores of a step, of the last ones of an episode above all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import mazes
from eihrl_jax.baselines import flat
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as config
from eihrl_jax.envs import goal_maze, wrappers
from tests.envs import sled


@pytest.mark.parametrize(("ctrl", "is_goal"), [(-1.0, True), (0.0, False)], ids=["goal", "limit"])
def test_a_goal_ends_the_task_and_a_time_limit_does_not(ctrl, is_goal):
    maze = mazes.parse("####\n#1S#\n####\n", num_decisions=1)
    env = wrappers.AutoReset(goal_maze.GoalMaze(sled.Disc(), maze))
    options = config.FlatConfig(num_envs=1, capacity=10)
    droq = flat.FlatDroq(World(env, 2, (12, 9), sled.K), options)
    envs = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 1))
    step, is_over = jax.jit(droq._step), False
    for _ in range(sled.K):
        assert not is_over
        seen = droq.see(envs.obs)
        envs, row = step(envs, jnp.array([[ctrl, 0.0]]))
        is_end, is_over = bool(envs.terminated[0]), bool((envs.terminated | envs.truncated)[0])
        np.testing.assert_allclose(row.discount, 0.0 if is_end else options.learner.gamma)
        np.testing.assert_allclose(row.reward, 1.0 if is_end else 0.0)
        np.testing.assert_array_equal(row.obs, seen)
        # Where the step led to, not where the next episode begins.
        np.testing.assert_allclose(row.next_obs[0, :2] - seen[0, :2], [ctrl / sled.K, 0], atol=1e-6)
        if is_end:
            break
    assert is_over and is_end == is_goal
