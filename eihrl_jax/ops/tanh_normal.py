"""The squashed Gaussian of soft actor-critic: a = tanh(u), u ~ N(mean, exp(log_std)^2)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key


def sample(
    mean: Float[Array, "*batch A"], log_std: Float[Array, "*batch A"], key: Key[Array, ""]
) -> tuple[Float[Array, "*batch A"], Float[Array, "*batch"]]:
    """Draws actions with their log-probability densities.

    log p(a) = sum_i [log N(u_i; mean_i, std_i) - log(1 - tanh(u_i)^2)], with the last term written
    as 2 (log 2 - u - softplus(-2u)), which does not cancel for large |u|.

    Args:
      mean: float32 [..., A], mean before squashing.
      log_std: float32 [..., A], log of the standard deviation before squashing.
      key: consumed.

    Returns:
      The actions in (-1, 1) [..., A], and their log-densities [...].

    Source: Haarnoja et al. 2018, Soft Actor-Critic, Appendix C.
    """
    noise = jax.random.normal(key, mean.shape)
    unsquashed = mean + jnp.exp(log_std) * noise
    log_normal = -0.5 * jnp.square(noise) - log_std - 0.5 * jnp.log(2 * jnp.pi)
    # The logarithm of the derivative of tanh at u.
    log_slope = 2.0 * (jnp.log(2.0) - unsquashed - jax.nn.softplus(-2.0 * unsquashed))
    return jnp.tanh(unsquashed), jnp.sum(log_normal - log_slope, axis=-1)
