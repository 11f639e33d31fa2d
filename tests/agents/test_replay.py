"""The replay, with rows that say who they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.agents import replay


def _rows(first, count):
    number = jnp.arange(first, first + count)
    return {
        "number": number,
        "pair": jnp.stack([number, -number], axis=1).astype(jnp.float32),
        "is_even": number % 2 == 0,
    }


def _empty(capacity):
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), _rows(0, 1))
    return replay.init(one, capacity)


def _check_identity(drawn):
    number = np.asarray(drawn["number"])
    np.testing.assert_array_equal(drawn["pair"], np.stack([number, -number], axis=-1))
    np.testing.assert_array_equal(drawn["is_even"], number % 2 == 0)


def test_draws_only_what_was_added_and_keeps_rows_together():
    stored = replay.add(_empty(12), _rows(100, 4))
    drawn = replay.sample(stored, (3, 50), jax.random.key(0))
    assert drawn["number"].shape == (3, 50) and drawn["is_even"].dtype == bool
    assert set(np.unique(drawn["number"])) == {100, 101, 102, 103}
    _check_identity(drawn)


def test_oldest_rows_make_room():
    stored = _empty(8)
    for first in (0, 4, 8):
        stored = replay.add(stored, _rows(first, 4))
    drawn = replay.sample(stored, (400,), jax.random.key(1))
    assert set(np.unique(drawn["number"])) == set(range(4, 12))
    assert int(stored.size) == 8 and int(stored.position) == 4
    _check_identity(drawn)


def test_draws_uniformly():
    stored = replay.add(_empty(8), _rows(0, 8))
    count = np.bincount(replay.sample(stored, (8000,), jax.random.key(2))["number"])
    assert np.abs(count - 1000).max() < 5 * np.sqrt(1000)


def test_batch_that_could_wrap_is_refused():
    with pytest.raises(ValueError, match="capacity 10 is no multiple of the batch's 4 rows"):
        replay.add(_empty(10), _rows(0, 4))
