"""TD3's penalty, weights and noise; its values are those of `test_probes`."""

import functools

import jax
import jax.numpy as jnp
import pytest

from eihrl_jax import base
from eihrl_jax.baselines.higl import td3
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

    state = jax.jit(AGENT.init)(jax.random.key(0))
    keys = jax.random.split(jax.random.key(1), num_updates)
    return jax.jit(functools.partial(jax.lax.scan, body))(state, keys)


def transitions(key, reward):
    """Ends after random observations and actions, which pay `reward`."""
    obs_key, action_key, next_key = jax.random.split(key, 3)
    shape = (OPTIONS.batch_size, 2)
    obs = jax.random.uniform(obs_key, shape, minval=-1.0, maxval=1.0)
    action = jax.random.uniform(action_key, (shape[0], 1), minval=-1.0, maxval=1.0)
    return base.Transition(
        obs=obs,
        action=action,
        reward=jnp.full(shape[0], reward, jnp.float32),
        discount=jnp.zeros(shape[0]),
        next_obs=jax.random.uniform(next_key, shape, minval=-1.0, maxval=1.0),
    )


def test_a_penalty_moves_the_actor_and_not_the_critics():
    def batch(key):
        return transitions(key, 0.0)

    state, _ = learn(batch, 800, lambda action: 10.0 * jnp.square(action - 0.5).mean())
    assert AGENT.act(state.actor.params, jnp.zeros(2)) == pytest.approx(0.5, abs=0.1)
    found = AGENT.values(state.critics.params, jnp.zeros((1, 2)), jnp.full((1, 1), 0.5))
    assert found == pytest.approx(0.0, abs=0.05)


def test_what_has_no_weight_teaches_nothing():
    state = jax.jit(AGENT.init)(jax.random.key(0))
    batch = transitions(jax.random.key(1), 100.0)
    weight, key = jnp.zeros(OPTIONS.batch_size), jax.random.key(2)
    after, metrics = jax.jit(AGENT.update)(state, batch, weight, key)
    assert metrics["critic_loss"] == 0.0
    for old, new in zip(
        *map(jax.tree.leaves, (state.critics.params, after.critics.params)), strict=True
    ):
        assert jnp.array_equal(old, new)


def test_exploring_stays_within_reach():
    agent = td3.Td3(2, 1, config.Td3(reach=2.0, noise=5.0))
    action = jax.vmap(lambda key: agent.explore(jnp.ones(1), key))(
        jax.random.split(jax.random.key(0), 200)
    )
    assert action.min() == -2.0 and action.max() == 2.0
