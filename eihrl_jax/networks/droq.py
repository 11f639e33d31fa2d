"""Actor and dropout critics of DroQ (Hiraoka et al. 2021, Sec. 3)."""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, UInt32

LOG_STD_RANGE = (-20.0, 2.0)

_DENSE_INIT = nn.initializers.xavier_uniform()


class Actor(nn.Module):
    """A squashed Gaussian's mean and log standard deviation from features.

    Attributes:
      num_actions: size A of the action.
      hidden_sizes: widths of the ReLU layers.
    """

    num_actions: int
    hidden_sizes: Sequence[int] = (256, 256)

    @nn.compact
    def __call__(
        self, obs: Float[Array, "... F"]
    ) -> tuple[Float[Array, "... A"], Float[Array, "... A"]]:
        """Returns mean and log standard deviation before squashing."""
        hidden = obs
        for size in self.hidden_sizes:
            hidden = nn.relu(nn.Dense(size, kernel_init=_DENSE_INIT)(hidden))
        out = nn.Dense(2 * self.num_actions, kernel_init=_DENSE_INIT)(hidden)
        mean, log_std = jnp.split(out, 2, axis=-1)
        return mean, jnp.clip(log_std, *LOG_STD_RANGE)


class Critic(nn.Module):
    """One Q-function with dropout and layer normalisation in every hidden block.

    Attributes:
      hidden_sizes: widths of the blocks Dense, dropout, LayerNorm, ReLU.
      dropout_rate: probability with which a unit is dropped.
    """

    hidden_sizes: Sequence[int] = (256, 256)
    dropout_rate: float = 0.01

    @nn.compact
    def __call__(
        self, obs: Float[Array, "B F"], action: Float[Array, "B A"], key: Key[Array, ""]
    ) -> Float[Array, " B"]:
        """Returns action values; DroQ drops units in every pass, so the key is always needed."""
        hidden = jnp.concatenate([obs, action], axis=-1)
        for size, layer_key in zip(
            self.hidden_sizes, jax.random.split(key, len(self.hidden_sizes)), strict=True
        ):
            # Hiraoka et al. 2021, Sec. 3: dropout comes before the layer normalisation.
            hidden = nn.Dense(size, kernel_init=_DENSE_INIT)(hidden)
            hidden = dropout(hidden, self.dropout_rate, layer_key)
            hidden = nn.relu(nn.LayerNorm()(hidden))
        return nn.Dense(1, kernel_init=_DENSE_INIT)(hidden)[..., 0]


def dropout(units: Float[Array, "B H"], rate: float, key: Key[Array, ""]) -> Float[Array, "B H"]:
    """Drops units with probability `rate`, and scales the others by 1 / (1 - rate).

    Each 32-bit word decides about two units, with probabilities that are multiples of 2^-16. H must
    be even.
    """
    if rate == 0.0:
        return units
    words = _hashed_words((units.shape[0], units.shape[1] // 2), key)
    halves = jax.lax.bitcast_convert_type(words, jnp.uint16).reshape(units.shape)
    # Of 2^16 numbers, all equally likely, a share of `rate` lies below this one.
    is_kept = halves >= jnp.uint16(round(rate * 2**16))
    return jnp.where(is_kept, units / (1.0 - rate), 0.0)


def _hashed_words(shape: tuple[int, int], key: Key[Array, ""]) -> UInt32[Array, "B W"]:
    """Returns hashed counters: murmur3's finaliser of a Weyl sequence, seeded twice by the key.

    Good enough to drop units, and an eighth of the cost of threefry on CPU, where drawing the masks
    with `jax.random.bits` takes as long as the matrix products of an update.
    """
    seed, stir = jax.random.key_data(key)
    counter = jax.lax.iota(jnp.uint32, shape[0] * shape[1]).reshape(shape)

    # The first constant, 2^32 over the golden ratio, is the Weyl sequence's step; the other two are
    # murmur3's.
    word = counter * jnp.uint32(0x9E3779B9) + seed
    word = (word ^ (word >> 16)) * jnp.uint32(0x85EBCA6B) + stir
    word = (word ^ (word >> 13)) * jnp.uint32(0xC2B2AE35)
    return word ^ (word >> 16)
