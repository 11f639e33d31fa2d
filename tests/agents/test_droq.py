"""DroQ's temperature and book-keeping; its values are told by `tests.baselines.test_probes`."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.agents import droq
from eihrl_jax.config import low as low_config

OPTIONS = low_config.Droq(
    hidden=(32, 32), learning_rate=3e-3, temperature=1e-3, target_rate=0.05, actor_period=2
)


def _learner(**changes):
    return droq.Droq(2, 1, dataclasses.replace(OPTIONS, **changes))


def _batch(key, reward, discount, size=64):
    """Steps from random observations to random ones; `reward` maps (obs, action)."""
    obs_key, action_key, next_key = jax.random.split(key, 3)
    obs = jnp.sign(jax.random.normal(obs_key, (size, 2)))
    action = jax.random.uniform(action_key, (size, 1), minval=-1.0, maxval=1.0)
    return base.Transition(
        obs=obs,
        action=action,
        reward=reward(obs, action),
        discount=jnp.full(size, discount),
        next_obs=jnp.sign(jax.random.normal(next_key, (size, 2))),
    )


def _train(learner, reward, discount, num_updates=400):
    def body(state, key):
        batch_key, update_key = jax.random.split(key)
        return learner.update(state, _batch(batch_key, reward, discount), update_key)

    keys = jax.random.split(jax.random.key(1), num_updates)
    return jax.jit(lambda state: jax.lax.scan(body, state, keys))(
        jax.jit(learner.init)(jax.random.key(0))
    )


def test_temperature_moves_entropy_to_its_target():
    learner = _learner(temperature=1.0, target_entropy=-1.0, learning_rate=1e-2)
    _, metrics = _train(learner, lambda obs, action: -4.0 * jnp.square(action[:, 0]), 0.0, 1500)
    assert float(jnp.nanmean(metrics["entropy"][-200:])) == pytest.approx(-1.0, abs=0.3)


def test_actor_moves_every_period_and_targets_trail():
    learner = _learner(actor_period=3)
    state = jax.jit(learner.init)(jax.random.key(0))
    batch = _batch(jax.random.key(1), lambda obs, action: obs[:, 0], 0.9)
    update, is_same = jax.jit(learner.update), []
    for i in range(3):
        new, metrics = update(state, batch, jax.random.key(i))
        pairs = zip(
            jax.tree.leaves(state.actor_params), jax.tree.leaves(new.actor_params), strict=True
        )
        is_same.append(all(bool((old == leaf).all()) for old, leaf in pairs))
        assert bool(jnp.isnan(metrics["actor_loss"])) == is_same[-1]
        old_target, online, target = (
            jax.tree.leaves(tree)[1]
            for tree in (state.target_params, new.critic_params, new.target_params)
        )
        np.testing.assert_allclose(target, 0.95 * old_target + 0.05 * online, atol=1e-6)
        state = new
    assert is_same == [True, True, False]


def test_learning_rate_halves_with_the_updates():
    constant = _learner(actor_period=1)
    falling = _learner(actor_period=1, learning_rate_half_life=4)
    before = jax.jit(constant.init)(jax.random.key(0)).replace(num_updates=jnp.int32(8))
    batch = _batch(jax.random.key(1), lambda obs, action: obs[:, 0], 0.9)
    critic_key, actor_key = jax.random.split(jax.random.key(2))
    for update, key, names in (
        ("update_critic", critic_key, ("critic_params",)),
        ("update_actor", actor_key, ("actor_params", "log_temperature")),
    ):
        (wholly, _), (partly, _) = (
            jax.jit(getattr(learner, update))(before, batch, key) for learner in (constant, falling)
        )
        for name in names:
            start, whole, part = (
                jax.tree.leaves(getattr(x, name)) for x in (before, wholly, partly)
            )
            for at_start, after_whole, after_part in zip(start, whole, part, strict=True):
                expected = at_start + 0.25 * (after_whole - at_start)
                np.testing.assert_allclose(after_part, expected, atol=1e-6)
            changes = [float(jnp.abs(a - b).max()) for a, b in zip(start, whole, strict=True)]
            assert max(changes) > 1e-3


def test_average_of_the_actor_trails_it():
    learner = _learner(actor_period=1, average_rate=0.25)
    state = jax.jit(learner.init)(jax.random.key(0))
    batch = _batch(jax.random.key(1), lambda obs, action: obs[:, 0], 0.9)
    for i in range(2):
        new, _ = jax.jit(learner.update)(state, batch, jax.random.key(i))
        old, actor, found = (
            jax.tree.leaves(tree)[1]
            for tree in (state.average_params, new.actor_params, new.average_params)
        )
        np.testing.assert_allclose(found, 0.75 * old + 0.25 * actor, atol=1e-6)
        assert not np.array_equal(found, actor)
        state = new


def test_same_key_same_result_and_one_compilation():
    learner = _learner()
    state = jax.jit(learner.init)(jax.random.key(0))
    batch = _batch(jax.random.key(1), lambda obs, action: obs[:, 0], 0.9)
    traces = []

    @jax.jit
    def update(state, batch, key):
        traces.append(1)
        return learner.update(state, batch, key)

    first, _ = update(state, batch, jax.random.key(2))
    again, _ = update(state, batch, jax.random.key(2))
    update(first, batch, jax.random.key(3))
    assert len(traces) == 1
    for left, right in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(left, right)
        assert np.isfinite(left).all()
