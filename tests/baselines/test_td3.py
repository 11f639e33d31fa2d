"""TD3 finds the values and actions of transitions whose answers are known."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.baselines import td3
from eihrl_jax.config import higl as config

OPTIONS = config.Td3(
    hidden=(32, 32),
    actor_rate=1e-3,
    critic_decay=0.0,
    gamma=0.9,
    target_rate=0.05,
    noise=0.1,
    target_noise=0.02,
    target_clip=0.05,
    batch_size=64,
)
AGENT = td3.Td3(2, 1, OPTIONS)


def learn(make_batch, num_updates, penalty=None):
    """Trains on batches that a key makes, each transition counting fully."""

    def body(state, key):
        batch_key, update_key = jax.random.split(key)
        weight = jnp.ones(OPTIONS.batch_size)
        return AGENT.update(state, make_batch(batch_key), weight, update_key, penalty)

    state = AGENT.init(jax.random.key(0))
    keys = jax.random.split(jax.random.key(1), num_updates)
    return jax.jit(functools.partial(jax.lax.scan, body))(state, keys)


def transitions(key, reward, *, terminated):
    """Transitions between random observations, with random actions."""
    obs_key, action_key, next_key = jax.random.split(key, 3)
    shape = (OPTIONS.batch_size, 2)
    obs = jax.random.uniform(obs_key, shape, minval=-1.0, maxval=1.0)
    action = jax.random.uniform(action_key, (shape[0], 1), minval=-1.0, maxval=1.0)
    return base.Transition(
        obs=obs,
        action=action,
        reward=reward(obs, action),
        discount=jnp.full(shape[0], 0.0 if terminated else OPTIONS.gamma),
        next_obs=jax.random.uniform(next_key, shape, minval=-1.0, maxval=1.0),
    )


@pytest.mark.parametrize(("terminated", "value"), [(True, 1.0), (False, 10.0)])
def test_value_of_a_constant_reward_with_and_without_an_end(terminated, value):
    def batch(key):
        return transitions(key, lambda obs, action: jnp.ones(len(obs)), terminated=terminated)

    state, _ = learn(batch, 1500)
    found = AGENT.values(state.critic_params, jnp.zeros((1, 2)), jnp.zeros((1, 1)))
    assert found == pytest.approx(value, rel=0.1)


def test_the_actor_finds_the_action_that_an_observation_asks_for():
    def reward(obs, action):
        return -jnp.square(action[:, 0] - 0.8 * obs[:, 0])

    state, _ = learn(lambda key: transitions(key, reward, terminated=True), 2500)
    obs = jnp.array([[-0.8, 0.0], [0.0, 0.5], [0.8, -0.5]])
    action = np.asarray(AGENT.act(state.actor_params, obs)[:, 0])
    assert action == pytest.approx(0.8 * np.asarray(obs[:, 0]), abs=0.2)


def test_a_penalty_moves_the_actor_and_not_the_critics():
    def batch(key):
        return transitions(key, lambda obs, action: jnp.zeros(len(obs)), terminated=True)

    state, _ = learn(batch, 800, lambda action: 10.0 * jnp.square(action - 0.5).mean())
    assert AGENT.act(state.actor_params, jnp.zeros(2)) == pytest.approx(0.5, abs=0.1)
    found = AGENT.values(state.critic_params, jnp.zeros((1, 2)), jnp.full((1, 1), 0.5))
    assert found == pytest.approx(0.0, abs=0.05)


def test_what_has_no_weight_teaches_nothing():
    state = AGENT.init(jax.random.key(0))
    batch = transitions(
        jax.random.key(1), lambda obs, action: jnp.full(len(obs), 100.0), terminated=True
    )
    after, metrics = AGENT.update(state, batch, jnp.zeros(OPTIONS.batch_size), jax.random.key(2))
    assert metrics["critic_loss"] == 0.0
    for old, new in zip(
        *map(jax.tree.leaves, (state.critic_params, after.critic_params)), strict=True
    ):
        assert jnp.array_equal(old, new)


def test_exploring_stays_within_reach():
    agent = td3.Td3(2, 1, config.Td3(reach=2.0, noise=5.0))
    action = jax.vmap(lambda key: agent.explore(jnp.ones(1), key))(
        jax.random.split(jax.random.key(0), 200)
    )
    assert action.min() == -2.0 and action.max() == 2.0
