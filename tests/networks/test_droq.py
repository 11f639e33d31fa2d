"""Dropout masks and network shapes."""

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax.networks import droq


def test_dropout_rate_mean_and_independence():
    units = jnp.ones((512, 256))
    dropped = np.asarray(droq.dropout(units, 0.1, jax.random.key(0)))
    kept = dropped > 0
    count = kept.size
    assert abs(kept.mean() - 0.9) < 5 * np.sqrt(0.09 / count)
    np.testing.assert_allclose(dropped[kept], 1 / 0.9, rtol=1e-6)
    # Neighbours along both axes, and the two halves of one random word, drop independently.
    for left, right in ((kept[:, :-1], kept[:, 1:]), (kept[:-1], kept[1:])):
        correlation = np.corrcoef(left.ravel(), right.ravel())[0, 1]
        assert abs(correlation) < 5 / np.sqrt(left.size)


def test_masks_of_different_keys_are_independent():
    units = jnp.ones((256, 256))
    masks = [np.asarray(droq.dropout(units, 0.5, jax.random.key(i))) > 0 for i in range(2)]
    assert abs(np.corrcoef(masks[0].ravel(), masks[1].ravel())[0, 1]) < 5 / 256


def test_no_dropout_leaves_units_alone():
    units = jnp.arange(6.0).reshape(1, 6)
    np.testing.assert_array_equal(droq.dropout(units, 0.0, jax.random.key(0)), units)


def test_actor_clips_its_spread():
    actor = droq.Actor(num_actions=3, hidden_sizes=(8,))
    params = actor.init(jax.random.key(0), jnp.ones(5))["params"]
    mean, log_std = actor.apply({"params": params}, 1e4 * jnp.ones(5))
    assert mean.shape == log_std.shape == (3,)
    assert (log_std <= 2.0).all() and (log_std >= -20.0).all()
