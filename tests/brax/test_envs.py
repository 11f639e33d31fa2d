"""Our environments through Brax's eyes: same episodes, ends, metrics, both ways to wrap them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax import envs as brax_envs

from eihrl_jax import base, mazes, robots
from eihrl_jax.brax import LocomotionEnv, MazeEnv, replicating, wrap
from eihrl_jax.brax.envs import RobotEnv
from eihrl_jax.config import presets
from eihrl_jax.envs import wrappers
from eihrl_jax.mazes import layouts

K = robots.load("point").steps_per_subgoal
SHORT = dataclasses.replace(presets.LOW["point"], episode_steps=4)


def make(kind: str) -> RobotEnv:
    if kind == "locomotion":
        return LocomotionEnv(SHORT)
    pair = [mazes.parse(text, num_decisions=1) for text in (layouts.U, layouts.RANDOM)]
    return MazeEnv(pair[0] if kind == "maze" else mazes.stack(pair), "point")


def raw_keys(first: int, num: int) -> jax.Array:
    return jnp.stack([jax.random.PRNGKey(first + i) for i in range(num)])


def roll(env, actions, seed=5):
    """States of three rows, the first one of reset, stacked along the first axis."""
    # Brax's wrappers aren't as strict about types as the tests are.
    with jax.numpy_dtype_promotion("standard"):
        return _roll(env, actions, seed)


def _roll(env, actions, seed):
    state = jax.jit(env.reset)(raw_keys(seed, 3))
    assert jax.tree.structure(state) == jax.tree.structure(
        jax.eval_shape(env.step, state, actions[0])
    )

    def step(state, action):
        state = env.step(state, action)
        return state, state

    states = jax.jit(lambda state: jax.lax.scan(step, state, actions)[1])(state)
    return jax.tree.map(lambda first, rest: np.concatenate([first[None], rest]), state, states)


def actions_of(env, num):
    return np.random.default_rng(0).uniform(-1, 1, (num, 3, env.action_size)).astype(np.float32)


@pytest.mark.parametrize("kind", ["mazes", "locomotion"])
def test_the_same_key_is_the_same_episodes_as_in_the_bare_environment(kind):
    env = make(kind)
    actions = actions_of(env, env.episode_steps + 3)
    bare = wrappers.AutoReset(env.bare)
    state = jax.jit(jax.vmap(bare.reset))(jax.vmap(jax.random.key)(jnp.arange(5, 8)))

    def step(state, action):
        ctrl = jax.vmap(env.control)(action, state.obs)
        state = jax.vmap(bare.step)(state, ctrl)
        return state, (jax.vmap(env.see)(state.obs), jax.vmap(env.see)(state.final_obs), state)

    first = jax.vmap(env.see)(state.obs)
    obs, final, bare_states = jax.jit(lambda s: jax.lax.scan(step, s, actions)[1])(state)

    got = roll(wrap(env), actions)
    np.testing.assert_array_equal(got.obs, np.concatenate([first[None], obs]))
    np.testing.assert_array_equal(got.info["final_obs"][1:], final)
    np.testing.assert_array_equal(got.reward[1:], bare_states.reward)
    np.testing.assert_array_equal(got.done[1:], bare_states.is_over)
    for name in ("truncation", "time_out"):
        np.testing.assert_array_equal(got.info[name][1:], bare_states.truncated)
    assert got.done.any() and got.info["steps"].max() == env.episode_steps

    # The same without wrapper, up to the first end.
    alone = jax.jit(env.reset)(jax.random.key(6))
    for i in range(2):
        np.testing.assert_allclose(alone.obs, got.obs[i, 1], atol=1e-5)
        alone = jax.jit(env.step)(alone, actions[i, 1])


def test_brax_own_wrapper_goes_back_to_where_an_episode_began():
    env = make("maze")
    length = 6
    states = roll(brax_envs.training.wrap(env, episode_length=length), actions_of(env, length + 1))
    np.testing.assert_array_equal(states.done[:, 0], np.eye(length + 2)[length])
    np.testing.assert_array_equal(states.info["truncation"], states.done)
    np.testing.assert_array_equal(states.obs[length], states.obs[0])
    assert (states.obs[-1] != states.obs[1]).any()
    # Ours draws anew, and the shorter of both limits holds.
    states = roll(wrap(env, episode_length=length), actions_of(env, length + 1))
    assert (states.obs[length] != states.obs[0]).any(1).all()
    np.testing.assert_array_equal(states.info["time_out"][:, 0], np.eye(length + 2)[length])


def test_a_goal_ends_an_episode_for_good_and_metrics_add_up():
    maze = mazes.parse("#####\n#S1##\n#####\n", num_decisions=2)
    env = MazeEnv(maze, "point")
    east = np.broadcast_to(np.float32([1.0, 0.0]), (2 * K, 3, 2))
    states = roll(brax_envs.training.EvalWrapper(wrap(env)), east)
    (end, *_) = np.flatnonzero(states.done[:, 0])
    assert end < 2 * K and states.info["truncation"][end, 0] == 0.0

    metrics = jax.tree.map(lambda x: x[-1, 0], states.info["eval_metrics"])
    assert metrics.episode_metrics["success"] == metrics.episode_metrics["reward"] == 1.0
    assert metrics.episode_metrics["steps"] == metrics.episode_steps == end
    assert all(leaf.dtype == np.float32 for leaf in jax.tree.leaves(states.metrics))


def test_an_observation_holds_the_goal_after_the_state():
    env = make("maze")
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    assert env.observation_size == state.obs.shape[0] == env.state_dim + len(env.goal_indices)
    assert (env.action_size, env.backend, env.dt) == (
        2,
        "mujoco",
        robots.load("point").control_step,
    )
    inner = state.pipeline_state.inner
    np.testing.assert_allclose(
        state.obs[env.goal_indices], inner.physics.qpos[:2] - np.array([13.5, -13.5]), atol=1e-6
    )
    np.testing.assert_array_equal(state.obs[env.state_dim :], [-7.5, 6.0])


def test_what_cannot_be_is_one_line():
    with pytest.raises(base.UserError, match="randomization_fn"):
        wrap(make("maze"), randomization_fn=print)
    with pytest.raises(base.UserError, match="engine 'bullet'"):
        MazeEnv("u", "point", engine="bullet")


def test_jax_has_what_brax_asks_for_only_meanwhile():
    devices = jax.local_devices()[:2]
    with replicating():
        copies = jax.device_put_replicated({"a": jnp.arange(3.0), "b": 1}, devices)
    assert not hasattr(jax, "device_put_replicated")
    np.testing.assert_array_equal(copies["a"], [[0, 1, 2]] * 2)
    assert copies["b"].shape == (2,) and copies["a"].sharding.device_set == set(devices)
