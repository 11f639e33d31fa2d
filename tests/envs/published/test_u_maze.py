"""HIGL's own maze: where goals lie, what is paid, and that its walls are four units wide."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs.published import u_maze
from eihrl_jax.physics import engines
from tests.envs.sled import K, Sled

MAZE = mazes.parse(u_maze.TEXT)


def test_goals_are_drawn_anywhere_in_training_and_far_away_in_evaluation():
    env = u_maze.UMaze(Sled(), MAZE)
    goal = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 500)).obs.goal_xy
    offset = np.asarray(goal) - np.array(u_maze.START_XY)
    np.testing.assert_allclose(offset.min(0), -2.0, atol=0.2)
    np.testing.assert_allclose(offset.max(0), 10.0, atol=0.2)
    test = jax.jit(u_maze.UMaze(Sled(), MAZE, is_evaluation=True).reset)(jax.random.key(0))
    np.testing.assert_allclose(test.obs.goal_xy - test.obs.xy, u_maze.FAR_XY)


@pytest.mark.parametrize("is_evaluation", [False, True])
def test_the_goal_ends_an_evaluation_and_not_a_training(is_evaluation):
    env = u_maze.UMaze(Sled(), MAZE, is_evaluation=is_evaluation)
    state = jax.jit(env.reset)(jax.random.key(0))
    inner = state.inner.replace(goal_xy=state.obs.xy + jnp.array([base.CELL, 0.0]))
    step, go = jax.jit(env.step), jnp.zeros(8).at[0].set(1.0)
    rewards, state = [], state.replace(inner=inner)
    for _ in range(K):
        state = step(state, go)
        rewards.append(float(state.reward))
    # A fifth of a cell per step: within 2.5 of three units after the first one.
    assert rewards == [0.0] * K
    assert state.metrics["success"] == 1.0 and bool(state.terminated) == is_evaluation
    assert state.metrics["steps"] == (1 if is_evaluation else K)


def test_far_from_the_goal_each_step_costs_one_or_the_distance():
    for reward in ("sparse", "dense"):
        env = u_maze.UMaze(Sled(), MAZE, reward=reward, is_evaluation=True)
        start = jax.jit(env.reset)(jax.random.key(0))
        state = jax.jit(env.step)(start, jnp.zeros(8))
        assert state.reward == (-1.0 if reward == "sparse" else -8.0)


def test_walls_are_four_units_wide():
    """A ball that is pushed to the east from the start ends at the wall, 10 units away."""
    robot = robots.load("point")
    engine = engines.make(robot, "mujoco", u_maze.CELL)
    env = u_maze.UMaze(engine, MAZE)
    state = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    for _ in range(150):
        state = step(state, jnp.array([1.0, 0.0]))
    travelled = state.obs.xy - jnp.array(u_maze.START_XY)
    assert travelled[0] == pytest.approx(10.0 - robot.body_radius, abs=0.3)
    assert abs(travelled[1]) < 0.3
