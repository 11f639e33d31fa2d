"""The tile layer against a plain loop over tiles; shapes, batch independence."""

import jax
import jax.numpy as jnp
import numpy as np

from eihrl_jax.networks import patch_actor_critic

NETWORK = patch_actor_critic.PatchActorCritic(tile=2, tile_features=3, hidden=(5, 4))


def patches(num: int):
    """Draws patches of 3 x 3 tiles."""
    return jax.random.bernoulli(jax.random.key(0), 0.5, (num, 6, 6, 3))


def looped(params, patch):
    """Computes logits and value tile by tile in NumPy."""
    layers = jax.tree.map(np.asarray, params["params"])

    def dense(name, inputs):
        return inputs @ layers[name]["kernel"] + layers[name]["bias"]

    features = []
    for i in range(0, 6, 2):
        for j in range(0, 6, 2):
            tile = np.asarray(patch, np.float32)[i : i + 2, j : j + 2].ravel()
            features.append(np.maximum(dense("Dense_0", tile), 0.0))
    hidden = np.concatenate(features)
    for name in ("Dense_1", "Dense_2"):
        hidden = np.maximum(dense(name, hidden), 0.0)
    return dense("logits", hidden), dense("value", hidden)[0]


def test_equals_a_loop_over_tiles_alone_and_in_a_batch():
    batch = patches(4)
    params = NETWORK.init(jax.random.key(1), batch[0])
    logits, value = jax.jit(jax.vmap(NETWORK.apply, (None, 0)))(params, batch)
    assert logits.shape == (4, 4) and value.shape == (4,)
    for row, patch in enumerate(batch):
        expected_logits, expected_value = looped(params, patch)
        np.testing.assert_allclose(logits[row], expected_logits, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(value[row], expected_value, rtol=1e-4, atol=1e-6)


def test_first_policy_is_nearly_uniform():
    batch = patches(4)
    params = NETWORK.init(jax.random.key(1), batch[0])
    logits, _ = jax.vmap(NETWORK.apply, (None, 0))(params, batch)
    np.testing.assert_allclose(jax.nn.softmax(logits), jnp.full((4, 4), 0.25), atol=0.02)
