import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from eihrl_jax import base
from eihrl_jax.envs import hierarchy

K = 4


class Cart(struct.PyTreeNode):
    """What the hierarchy may pass along without knowing it."""

    physics: types.SimpleNamespace | struct.PyTreeNode
    is_running: jax.Array
    is_fallen: jax.Array


class Place(struct.PyTreeNode):
    """Where the cart is."""

    qpos: jax.Array


class Line:
    """A two-level probe: controls add up to a position, and the reward is how far a decision went.

    With a low level that obeys, a decision for x+ is worth K and one for x- is worth -K; with a low
    level that does the opposite it is the other way round.
    """

    robot = types.SimpleNamespace(steps_per_subgoal=K)
    table = None

    def reset(self, key, maze=None):
        """Starts at zero."""
        del maze
        zero, no = jnp.float32(0.0), jnp.zeros((), bool)
        cart = Cart(physics=Place(qpos=jnp.zeros(3)), is_running=~no, is_fallen=no)
        return base.EnvState(
            inner=cart,
            obs=zero,
            final_obs=zero,
            reward=zero,
            terminated=no,
            truncated=no,
            metrics={},
            key=key,
        )

    def begin(self, state, direction):
        """Gives the subgoal."""
        return direction, state.inner

    def low_obs(self, subgoal, body):
        """Shows direction and place."""
        return subgoal, body.physics.qpos[0]

    def control(self, subgoal, body, ctrl):
        """Moves; rests beyond six."""
        del subgoal
        qpos = body.physics.qpos.at[0].add(jnp.where(body.is_running, ctrl[0], 0.0))
        return Cart(
            physics=Place(qpos=qpos),
            is_running=body.is_running & (qpos[0] < 6.0),
            is_fallen=qpos[0] < 0.0,
        )

    def end(self, state, body, path_xy):
        """Pays for the way."""
        start = state.inner.physics.qpos[0]
        return state.replace(inner=body, reward=path_xy[-1, 0] - start)


def obey(obs, key):
    del key
    direction, _ = obs
    return jnp.where(direction == 0, 1.0, -1.0)[None]


def disobey(obs, key):
    return -obey(obs, key)


@pytest.mark.parametrize(("policy", "sign"), [(obey, 1.0), (disobey, -1.0)])
@pytest.mark.parametrize(("direction", "way"), [(0, 1.0), (1, -1.0)])
def test_decision_is_k_steps_of_the_low_level(policy, sign, direction, way):
    two_levels = hierarchy.Hierarchy(Line(), policy)
    state = two_levels.step(two_levels.reset(jax.random.key(0)), jnp.int32(direction))
    assert float(state.reward) == K * sign * way


def test_trace_tells_every_step_and_where_the_robot_rested():
    two_levels = hierarchy.Hierarchy(Line(), obey)
    state = two_levels.reset(jax.random.key(0))
    state, first = two_levels.trace(state, jnp.int32(0))
    np.testing.assert_array_equal(first.qpos[:, 0], [1, 2, 3, 4])
    assert first.is_running.all()
    _, second = two_levels.trace(state, jnp.int32(0))
    np.testing.assert_array_equal(second.qpos[:, 0], [5, 6, 6, 6])
    np.testing.assert_array_equal(second.is_running, [True, True, False, False])
    _, back = two_levels.trace(two_levels.reset(jax.random.key(0)), jnp.int32(1))
    assert back.is_fallen.all()


def test_every_step_has_its_own_randomness():
    def jitter(obs, key):
        del obs
        return jax.random.normal(key, (1,))

    two_levels = hierarchy.Hierarchy(Line(), jitter)
    state = two_levels.reset(jax.random.key(0))
    state, one = two_levels.trace(state, jnp.int32(0))
    _, two = two_levels.trace(state, jnp.int32(0))
    moves = np.diff(np.concatenate([one.qpos[:, 0], two.qpos[:, 0]]))
    assert len(np.unique(moves)) == 2 * K - 1


def test_eager_equals_jit_equals_vmap():
    two_levels = hierarchy.Hierarchy(Line(), obey)
    state = two_levels.reset(jax.random.key(0))
    eager = two_levels.step(state, jnp.int32(1))
    jitted = jax.jit(two_levels.step)(state, jnp.int32(1))
    states = jax.vmap(two_levels.reset)(jnp.stack([jax.random.key(0)] * 2))
    batched = jax.vmap(two_levels.step)(states, jnp.array([1, 0]))
    assert float(eager.reward) == float(jitted.reward) == float(batched.reward[0])
    assert float(batched.reward[1]) == K
