"""Where the robots of a baseline act."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from eihrl_jax import base


@dataclasses.dataclass(frozen=True)
class World:
    """An environment, and what a baseline needs to know about it.

    Attributes:
      env: its observation is a `base.GoalObs`. Its `step` rests where the episode is over; for a
        flat baseline it begins a new one there, see `envs.wrappers.AutoReset`.
      num_actions: size A of the robot's controls.
      side_xy: the arena's sides in units, its upper left corner at the origin.
      episode_steps: control steps of the longest episode.
    """

    env: base.Environment
    num_actions: int
    side_xy: tuple[int, int]
    episode_steps: int

    def reset(self, num_envs: int, key: Key[Array, ""]) -> base.EnvState:
        """Begins an episode in each of N environments."""
        return jax.vmap(self.env.reset)(jax.random.split(key, num_envs))

    def num_features(self, see: Callable[[base.GoalObs], Float[Array, " F"]]) -> int:
        """Returns the size F of what a function makes of an observation."""
        # Only shapes are traced: no episode begins for them.
        return jax.eval_shape(lambda key: see(self.env.reset(key).obs), jax.random.key(0)).shape[0]

    def centred(self, xy: Float[Array, "*B 2"]) -> Float[Array, "*B 2"]:
        """Returns positions relative to the arena's centre, units."""
        # The origin is the upper left corner and y points up: the centre lies below it.
        centre = jnp.array([self.side_xy[0] / 2.0, -self.side_xy[1] / 2.0])
        return xy - jnp.broadcast_to(centre, xy.shape)
