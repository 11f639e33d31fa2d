import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import mazes
from eihrl_jax.envs import oracle_maze, raster, wrappers

NUM_ENVS, NUM_STEPS = 32, 12


@pytest.fixture(scope="module")
def rollouts():
    """Returns states before and after steps, what the plain environment would do, and what is seen.

    The last is drawn by the plain environment's own steps and resets.
    """
    plain = oracle_maze.OracleMaze(
        mazes.load("random", num_decisions=4),
        jnp.asarray(np.random.default_rng(0).random((8, 15, 15)) < 0.1),
        view=raster.View(),
        movement=oracle_maze.Movement(),
    )
    env = wrappers.AutoReset(plain, plain.observe)

    def step(state, action):
        following = jax.vmap(env.step)(state, action)
        drawn = jax.vmap(wrappers.AutoReset(plain).step)(state, action).obs
        return following, (state, following, jax.vmap(plain.step)(state, action), drawn)

    @jax.jit
    def run(keys, actions):
        return jax.lax.scan(step, jax.vmap(env.reset)(keys), actions)[1]

    actions = np.random.default_rng(0).integers(4, size=(NUM_STEPS, NUM_ENVS))
    return run(jax.random.split(jax.random.key(0), NUM_ENVS), jnp.asarray(actions, jnp.int32))


def test_auto_reset(rollouts):
    before, states, plain, drawn = rollouts
    np.testing.assert_array_equal(states.obs, drawn)
    is_done = np.asarray(states.terminated | states.truncated)
    assert is_done.sum() >= NUM_ENVS * NUM_STEPS / 4

    # What ended is told as the plain environment tells it.
    for told, expected in (
        (states.reward, plain.reward),
        (states.terminated, plain.terminated),
        (states.truncated, plain.truncated),
        (states.metrics["return"], plain.metrics["return"]),
        (states.metrics["decisions"], plain.metrics["decisions"]),
        (states.final_obs, plain.obs),
    ):
        np.testing.assert_array_equal(told, expected)

    # A running episode runs on; after an end another one begins, with its own start and door.
    np.testing.assert_array_equal(states.obs[~is_done], plain.obs[~is_done])
    np.testing.assert_array_equal(states.inner.xy[~is_done], plain.inner.xy[~is_done])
    decisions = np.asarray(states.inner.nav.decisions)
    np.testing.assert_array_equal(decisions[is_done], 0)
    np.testing.assert_array_equal(states.inner.total_reward[is_done], 0.0)
    assert not np.asarray(states.inner.nav.visited)[is_done].any()
    np.testing.assert_array_equal(decisions[~is_done], before.inner.nav.decisions[~is_done] + 1)
    assert (states.inner.xy != plain.inner.xy)[is_done].any(-1).all()
    doors = np.asarray(states.inner.nav.door_ij)[is_done]
    assert len(np.unique(doors, axis=0)) > 15
    starts = np.floor(np.asarray(states.inner.xy)[is_done] / 3)
    assert len(np.unique(starts, axis=0)) > 20
    assert (np.asarray(states.obs != states.final_obs).any((2, 3, 4)) == is_done).mean() > 0.99


def test_every_step_of_every_environment_has_its_own_key(rollouts):
    states = rollouts[1]
    words = np.asarray(jax.random.key_data(states.key)).reshape(-1, 2)
    assert len(np.unique(words, axis=0)) == NUM_ENVS * NUM_STEPS
