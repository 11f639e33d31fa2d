import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.ops import batching


def root(x):
    return {"root": jnp.sqrt(x), "key": jax.random.fold_in(jax.random.key(0), x.astype(int))}


def chosen(condition, x):
    otherwise = {"root": -x, "key": jax.random.key(7)}
    return batching.where_needed(condition, root, x, otherwise)


ROWS = jax.jit(jax.vmap(chosen))


@pytest.mark.parametrize("size", [1, 5, 64])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_rows_are_those_that_where_chooses(size, share):
    x = jnp.arange(1.0, size + 1.0)
    condition = np.random.default_rng(0).random(size) < share
    rows, computed = ROWS(condition, x), jax.vmap(root)(x)

    np.testing.assert_array_equal(rows["root"], jnp.where(condition, computed["root"], -x))
    words = jax.random.key_data(jnp.where(condition, computed["key"], jax.random.key(7)))
    np.testing.assert_array_equal(jax.random.key_data(rows["key"]), words)


def test_one_condition_for_all_rows_and_batches_of_batches():
    x = jnp.arange(6.0).reshape(2, 3)
    for condition, expected in ((True, jnp.sqrt(x[0])), (False, -x[0])):
        alike = jax.vmap(chosen, in_axes=(None, 0))(jnp.array(condition), x[0])
        np.testing.assert_array_equal(alike["root"], expected)

    condition = x > 2.0
    nested = jax.vmap(jax.vmap(chosen))(condition, x)["root"]
    np.testing.assert_array_equal(nested, jnp.where(condition, jnp.sqrt(x), -x))


@pytest.mark.parametrize("num_needed, num_computed", [(0, 0), (1, 8), (8, 8), (9, 16), (64, 64)])
def test_no_more_than_an_eighth_too_many_is_computed(num_needed, num_computed):
    computed = []

    def watched(x):
        jax.debug.callback(computed.append, x)
        return x

    condition = jnp.arange(64) < num_needed
    rows = jax.vmap(lambda need, x: batching.where_needed(need, watched, x, -x))
    jax.block_until_ready(jax.jit(rows)(condition, jnp.arange(64.0)))
    jax.effects_barrier()
    assert len(computed) == num_computed
