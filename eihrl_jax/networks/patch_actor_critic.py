"""Policy and value of the high level from a top-view patch (paper, Figure 8, which is not legible).

The first layer is one matrix product over square tiles of about a maze cell instead of a
convolution: with a tile's stride equal to its size the two compute the same, and XLA's
convolutions are many times slower than its matrix products on CPU.
"""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from eihrl_jax import base


class PatchActorCritic(nn.Module):
    """Shared trunk over a patch, with a head for the logits of the subgoals and one for the value.

    Attributes:
      tile: side of a tile in pixels; divides the patch.
      tile_features: outputs of the first layer per tile; all tiles share its weights.
      hidden: widths of the dense layers that follow.
    """

    tile: int = 5
    tile_features: int = 16
    hidden: tuple[int, ...] = (128,)

    @nn.compact
    def __call__(self, patch: Bool[Array, "P P C"]) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the four subgoals and the value of the patch.

        Source: paper, Appendix C.1 and Figure 8; sizes are ours, the figure does not give any.
        """
        num_tiles, channels = patch.shape[0] // self.tile, patch.shape[2]
        # One row per tile, so that one matrix product serves all tiles.
        tiles = patch.reshape(num_tiles, self.tile, num_tiles, self.tile, channels)
        tiles = tiles.swapaxes(1, 2).reshape(num_tiles**2, -1).astype(jnp.float32)

        trunk_init = nn.initializers.orthogonal(2**0.5)
        features = nn.relu(nn.Dense(self.tile_features, kernel_init=trunk_init)(tiles)).ravel()
        for width in self.hidden:
            features = nn.relu(nn.Dense(width, kernel_init=trunk_init)(features))

        # Small logits make the first policy uniform, whatever the patch shows.
        logits_init, value_init = nn.initializers.orthogonal(0.01), nn.initializers.orthogonal(1.0)
        logits = nn.Dense(base.NUM_DIRECTIONS, kernel_init=logits_init, name="logits")(features)
        value = nn.Dense(1, kernel_init=value_init, name="value")(features)
        return logits, value[0]
