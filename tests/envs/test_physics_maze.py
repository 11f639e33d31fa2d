import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs import hierarchy, physics_maze, raster, task
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import engines
from tests.envs import pictures
from tests.envs.sled import K, Sled

TEXT = """\
#####
#S.1#
#.#.#
#2..#
#####
"""
EAST, WEST, NORTH, SOUTH = range(4)


TURNS_BACK, STUMBLES, BREAKS, IS_NAN = range(1, 5)
"""What else may happen to a robot that drives in the direction asked for."""


def drive(obs, key, mishap):
    """Drives in the direction asked for, unless something happens."""
    del key
    ctrl = jnp.zeros(8).at[:2].set(jnp.array(base.DIRECTIONS_XY)[obs.direction])
    is_late = obs.time_left <= 0.5
    falls = (mishap == STUMBLES) & (obs.direction == NORTH) & (obs.time_left == 1.0)
    ctrl = ctrl * jnp.where((mishap == TURNS_BACK) & is_late, -1.0, 1.0)
    ctrl = ctrl.at[2].set(falls.astype(jnp.float32))
    ctrl = ctrl.at[3].set(((mishap == BREAKS) & is_late).astype(jnp.float32))
    return jnp.where(mishap == IS_NAN, jnp.nan, ctrl)


@pytest.fixture(scope="module")
def maze():
    return mazes.parse(TEXT, num_decisions=6)


@pytest.fixture(scope="module")
def env(maze):
    return physics_maze.PhysicsMaze(Sled(), maze, view=raster.View())


@pytest.fixture(scope="module")
def dense():
    longer = mazes.parse(TEXT, num_decisions=8)
    return physics_maze.PhysicsMaze(Sled(), longer, view=raster.View(), reward="dense")


@functools.cache
def compiled(env):
    """Returns reset and step, compiled once for all tests."""

    @jax.jit
    def step(state, direction, mishap):
        policy = functools.partial(drive, mishap=mishap)
        return hierarchy.Hierarchy(env, policy).step(state, direction)

    return jax.jit(env.reset), step


def steps(env, directions, state=None, mishap=0):
    """Returns the states after each of some decisions."""
    reset, step = compiled(env)
    states = [reset(jax.random.key(0)) if state is None else state]
    for direction in directions:
        states.append(step(states[-1], jnp.int32(direction), mishap))
    return states


def test_goals_pay_once_and_the_last_one_ends_the_episode(env):
    states = steps(env, [EAST, EAST, WEST, EAST, SOUTH, SOUTH])
    assert [float(state.reward) for state in states] == [0, 0, 1, 0, 0, 0, 0]
    assert not any(bool(state.terminated) for state in states)
    assert [bool(state.truncated) for state in states] == [False] * 6 + [True]
    assert float(states[-1].metrics["success"]) == 0.5
    states = steps(env, [EAST, EAST, SOUTH, SOUTH, WEST, WEST])
    assert [float(state.metrics["return"]) for state in states] == [0, 0, 1, 1, 1, 1, 2]
    assert bool(states[-1].terminated)
    assert not bool(states[-1].truncated)


def test_dense_reward_tells_where_a_decision_ends_until_the_time_is_up(dense):
    first, *states = steps(dense, [EAST, EAST, SOUTH, SOUTH, WEST, WEST, EAST, NORTH])
    start, *ends = (np.asarray(state.inner.body.physics.qpos[:2]) for state in (first, *states))
    goals_xy = {1: np.array([10.5, -4.5]), 2: np.array([4.5, -10.5])}
    np.testing.assert_array_less(base.CELL, np.linalg.norm(goals_xy[1] - start))
    # The first goal until it is reached in the second decision, then the other one.
    expected = [
        1.0 / (1.0 + np.linalg.norm(goals_xy[1 if i < 1 else 2] - xy)) for i, xy in enumerate(ends)
    ]
    expected[5:] = [1.0] * 3  # for having arrived
    np.testing.assert_allclose([float(state.reward) for state in states], expected, rtol=1e-5)
    assert float(states[-1].metrics["return"]) == pytest.approx(sum(expected), rel=1e-5)
    assert float(states[-1].metrics["success"]) == 1.0
    assert not any(bool(state.terminated) for state in states)
    assert [bool(state.truncated) for state in states] == [False] * 7 + [True]


def test_with_dense_reward_the_robot_goes_on_after_the_last_goal(dense):
    states = steps(dense, [EAST, EAST, SOUTH, SOUTH, WEST, WEST, EAST, NORTH])
    assert [float(state.metrics["success"]) for state in states[-3:]] == [1.0, 1.0, 1.0]
    before, after = (state.inner.body.physics.qpos[:2] for state in states[-3:-1])
    np.testing.assert_allclose(after - before, [base.CELL, 0.0], atol=0.1)


def test_goal_is_seen_on_the_way(env):
    state = steps(env, [EAST])[-1]
    before = state.inner.body.physics.qpos[0]
    state = steps(env, [EAST], state, mishap=TURNS_BACK)[-1]
    assert float(state.reward) == 1.0
    assert float(state.inner.body.physics.qpos[0] - before) == pytest.approx(base.CELL / K)


def test_robot_rests_from_the_last_goal_on(env):
    states = steps(env, [EAST, EAST, SOUTH, SOUTH, WEST, WEST, WEST])
    solved, after = (state.inner.body.physics.qpos for state in states[-2:])
    np.testing.assert_array_equal(solved, after)
    # It stopped at the goal's edge, within its subgoal.
    assert float(solved[0]) > 2 * base.CELL - 2 * base.CELL / K


def test_fall_is_counted_and_ends_nothing(env):
    states = steps(env, [EAST, NORTH, SOUTH], mishap=STUMBLES)
    assert [float(state.metrics["fell"]) for state in states] == [0, 0, 1, 1]
    assert not bool(states[-1].terminated)


def test_broken_simulation_ends_the_episode_without_nan(env):
    for mishap in (BREAKS, IS_NAN):
        start, state, later = steps(env, [EAST, EAST], mishap=mishap)
        assert bool(state.terminated)
        assert not bool(state.truncated)
        assert float(state.metrics["broke_down"]) == 1.0
        assert float(start.metrics["broke_down"]) == 0.0
        assert float(state.reward) == 0.0
        for leaf in jax.tree.leaves((state.inner, state.obs)):
            assert np.isfinite(leaf).all()
        np.testing.assert_array_equal(state.inner.body.physics.qpos, later.inner.body.physics.qpos)


def test_patch_shows_the_real_surroundings(env, maze):
    state = steps(env, [EAST])[-1]
    xy = state.inner.body.physics.qpos[:2]
    robot = state.obs[..., 2]
    assert bool(robot[7, 7])
    visited = jnp.zeros(9, bool)
    expected = pictures.patch(maze, xy, visited, robot, env.view)
    np.testing.assert_array_equal(state.obs, expected)
    assert bool(state.obs[..., 1].any())


def test_reset_draws_anew_in_the_maze_asked_for(maze):
    room = mazes.load("random")
    env = physics_maze.PhysicsMaze(Sled(), mazes.stack([maze, room]), view=raster.View())
    keys = jax.random.split(jax.random.key(0), 16)
    states = jax.jit(jax.vmap(env.reset))(keys, jnp.arange(16) % 2)
    np.testing.assert_array_equal(states.inner.nav.maze, np.arange(16) % 2)
    starts = np.asarray(states.inner.body.physics.qpos[1::2, :2])
    assert len(np.unique(starts, axis=0)) == 8
    assert len(np.unique(np.asarray(states.inner.nav.door_ij[1::2]), axis=0)) > 3
    xy = states.inner.body.physics.qpos[:, :2]
    codes = jax.jit(jax.vmap(task.code_at, (None, 0, 0)))(env.table, states.inner.nav, xy)
    assert (codes == 0).all()


@pytest.fixture(scope="module")
def rolling():
    """A point robot on the C engine, in a room that it is to leave through the east."""
    text = "######\n#....#\n#S...1\n#....#\n######\n"
    engine = engines.make(robots.load("point"))
    env = physics_maze.PhysicsMaze(engine, mazes.parse(text, num_decisions=8), view=raster.View())

    def push(obs, key):
        del key
        return jnp.zeros(engine.model.nu).at[:2].set(jnp.array(base.DIRECTIONS_XY)[obs.direction])

    two_levels = hierarchy.Hierarchy(env, push)
    return two_levels, jax.jit(two_levels.trace)


def test_point_robot_drives_to_the_door(rolling):
    two_levels, trace = rolling
    state = jax.jit(two_levels.reset)(jax.random.key(1))
    while not state.is_over:
        state, _ = trace(state, jnp.int32(EAST))
    assert bool(state.terminated)
    assert float(state.metrics["success"]) == 1.0
    assert 3 <= int(state.inner.nav.decisions) <= 6
    # The engine leaves a robot alone whose episode is over.
    later, _ = trace(state, jnp.int32(WEST))
    np.testing.assert_array_equal(later.inner.body.physics.qpos, state.inner.body.physics.qpos)
    np.testing.assert_array_equal(later.inner.body.physics.qvel, state.inner.body.physics.qvel)


def test_walls_stop_it_and_batches_change_nothing(rolling):
    keys = jax.random.split(jax.random.key(2), 4)
    directions = jnp.array([WEST, NORTH, SOUTH, NORTH])
    two_levels, trace = rolling
    states, traces = jax.jit(jax.vmap(two_levels.reset))(keys), []
    batched = jax.jit(jax.vmap(two_levels.trace))
    single = jax.tree.map(lambda leaf: leaf[1], states)
    for _ in range(3):
        states, together = batched(states, directions)
        single, alone = trace(single, directions[1])
        np.testing.assert_array_equal(together.qpos[1], alone.qpos)
        traces.append(together.qpos)
    xy = np.concatenate(traces, 1)[..., :2]
    half = base.CELL - 0.1
    assert xy[..., 0].min() > half
    assert xy[..., 1].max() < -half
    assert xy[..., 1].min() > -4 * base.CELL - 0.1
    assert xy[0, -1, 0] < 1.5 * base.CELL  # it did get there


@pytest.mark.parametrize("anchored", [False, True])
def test_an_anchored_subgoal_counts_from_the_middle_of_the_cell(maze, anchored):
    env = physics_maze.PhysicsMaze(Sled(), maze, view=raster.View(), anchored=anchored)
    state = env.reset(jax.random.key(0))
    torso_xy = state.inner.body.physics.qpos[:2]
    subgoal, body = env.begin(state, jnp.int32(EAST))
    centre = maze_lib.cell_xy(jnp.array([1, 1]))
    assert float(jnp.abs(torso_xy - centre).max()) > 1e-3
    np.testing.assert_allclose(subgoal.start_xy, centre if anchored else torso_xy, atol=1e-5)
    # The low level is told the way that it has already come, or has to make up for.
    come = env.low_obs(subgoal, body).displacement_xy
    np.testing.assert_allclose(come, torso_xy - subgoal.start_xy, atol=1e-5)
