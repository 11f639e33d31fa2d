"""Plain networks of the baselines: dense layers with ReLU, drawn as PyTorch draws them.

The released code of HIGL, and of HESS below its manager, relies on PyTorch's initial weights,
uniform within 1 / sqrt(inputs), which are smaller than Flax's and so begin nearer to zero values.
"""

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# A uniform law of variance 1 / (3 inputs) reaches as far as 1 / sqrt(inputs).
_KERNEL_INIT = nn.initializers.variance_scaling(1.0 / 3.0, "fan_in", "uniform")


class Mlp(nn.Module):
    """Dense layers with ReLU between them and a linear one at the end.

    Attributes:
      hidden: widths of the layers in between.
      num_outputs: width of the last one.
    """

    hidden: Sequence[int]
    num_outputs: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "... F"]) -> Float[Array, "... O"]:
        """Returns the outputs."""
        values = inputs
        for size in self.hidden:
            values = nn.relu(_dense(size, values.shape[-1])(values))
        return _dense(self.num_outputs, values.shape[-1])(values)


class Actor(nn.Module):
    """A deterministic policy whose actions lie within `reach` of zero.

    Attributes:
      hidden: widths of the hidden layers.
      num_actions: size A of the action.
      reach: greatest size of an action's entries.
    """

    hidden: Sequence[int]
    num_actions: int
    reach: float = 1.0

    @nn.compact
    def __call__(self, obs: Float[Array, "... F"]) -> Float[Array, "... A"]:
        """Returns actions."""
        return self.reach * jnp.tanh(Mlp(self.hidden, self.num_actions)(obs))


class Critic(nn.Module):
    """Values of actions.

    Attributes:
      hidden: widths of the hidden layers.
      gamma: where it is given, the output d is a time, in steps that each cost 1 until it is over,
        and stands for the value -(1 - gamma^d) / (1 - gamma).
    """

    hidden: Sequence[int]
    gamma: float | None = None

    @nn.compact
    def __call__(
        self, obs: Float[Array, "... F"], action: Float[Array, "... A"]
    ) -> Float[Array, "..."]:
        """Returns one value per action."""
        output = Mlp(self.hidden, 1)(jnp.concatenate([obs, action], axis=-1))[..., 0]
        if self.gamma is None:
            return output
        # However large the output gets, the value never falls below -1 / (1 - gamma).
        return -(1.0 - self.gamma**output) / (1.0 - self.gamma)


def _dense(num_outputs: int, num_inputs: int) -> nn.Dense:
    """Returns a layer whose weights and biases are uniform within 1 / sqrt(inputs)."""
    limit = num_inputs**-0.5

    def bias_init(key: jax.Array, shape: Sequence[int], dtype: type = jnp.float32) -> jax.Array:
        return jax.random.uniform(key, shape, dtype, -limit, limit)

    return nn.Dense(num_outputs, kernel_init=_KERNEL_INIT, bias_init=bias_init)
