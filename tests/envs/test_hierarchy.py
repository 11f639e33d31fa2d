"""Two levels as one environment: k steps of whatever low level is put in, and the way they took."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.envs import hierarchy, physics_maze, raster
from tests.envs.sled import K, Sled

EAST, WEST = jnp.int32(0), jnp.int32(1)
GOAL_X = 3 * base.CELL
"""Where the goal's region begins, two cells from the start."""


@pytest.fixture(scope="module")
def env():
    return physics_maze.PhysicsMaze(
        Sled(), mazes.parse("#####\n#S.1#\n#####\n"), view=raster.View()
    )


@pytest.fixture(scope="module")
def start(env):
    return jax.jit(env.reset)(jax.random.key(0))


def drive(obs, key=None, sign=1.0, noise=None):
    """Drives in the direction asked for (sign 1) or against it, and lies down when it is west."""
    way = jnp.array(base.DIRECTIONS_XY)[obs.direction]
    ctrl = jnp.zeros(8).at[:2].set(sign * way)
    if noise is not None:
        ctrl = ctrl.at[0].add(noise * jax.random.normal(key))
    return ctrl.at[2].set((obs.direction == WEST).astype(jnp.float32))


@pytest.fixture(scope="module")
def trace(env):
    """A decision of any of these low levels, compiled once."""

    @jax.jit
    def traced(state, direction, sign=1.0, noise=0.0):
        policy = functools.partial(drive, sign=sign, noise=noise)
        return hierarchy.Hierarchy(env, policy).trace(state, direction)

    return traced


def x_of(state):
    return np.asarray(state.inner.body.physics.qpos[..., 0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("direction", "way"), [(EAST, 1.0), (WEST, -1.0)])
def test_decision_is_k_steps_of_the_low_level(trace, start, sign, direction, way):
    state, _ = trace(start, direction, sign)
    assert x_of(state) - x_of(start) == pytest.approx(base.CELL * sign * way, rel=1e-5)
    assert int(state.inner.nav.decisions) == 1


def test_trace_tells_every_step_and_where_the_robot_rested(trace, start):
    state, first = trace(start, EAST)
    way = base.CELL / K * np.arange(1, K + 1)
    np.testing.assert_allclose(first.qpos[:, 0] - x_of(start), way, atol=1e-5)
    assert first.is_running.all() and not first.is_fallen.any()

    _, second = trace(state, EAST)
    expected = x_of(state) + way
    num_steps = int((expected < GOAL_X).sum()) + 1  # the last one goes into the goal
    assert num_steps < K
    expected[num_steps:] = expected[num_steps - 1]
    np.testing.assert_allclose(second.qpos[:, 0], expected, atol=1e-5)
    np.testing.assert_array_equal(second.is_running, np.arange(K) < num_steps)
    _, back = trace(start, WEST)
    assert back.is_fallen.all()


def test_every_step_has_its_own_randomness(trace, start):
    state, one = trace(start, EAST, 0.0, 0.1)
    _, two = trace(state, EAST, 0.0, 0.1)
    moves = np.diff(np.concatenate([one.qpos[:, 0], two.qpos[:, 0]]))
    assert len(np.unique(moves)) == 2 * K - 1


def test_by_hand_equals_jit_equals_vmap(env, trace, start):
    """By hand, in Python: a subgoal begins, is followed for k control steps, and ends."""
    subgoal, body = jax.jit(env.begin)(start, WEST)
    control, path_xy = (
        jax.jit(lambda b: env.control(subgoal, b, drive(env.low_obs(subgoal, b)))),
        [],
    )
    for _ in range(K):
        body = control(body)
        path_xy.append(body.physics.qpos[:2])
    by_hand = jax.jit(env.end)(start, body, jnp.stack(path_xy))

    jitted, _ = trace(start, WEST)
    starts = jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), start)
    batched, _ = jax.vmap(trace)(starts, jnp.stack([WEST, EAST]))
    assert x_of(by_hand) == x_of(jitted) == x_of(batched)[0]
    np.testing.assert_array_equal(by_hand.obs, batched.obs[0])
    assert x_of(batched)[1] - x_of(start) == pytest.approx(base.CELL, rel=1e-5)
