"""Where the robots of a baseline act."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base
from eihrl_jax.agents import devices, replay
from eihrl_jax.ops import tree

OutT = TypeVar("OutT")
TreeT = TypeVar("TreeT")


@dataclasses.dataclass(frozen=True)
class World:
    """An environment, and what a baseline needs to know about it.

    Attributes:
      env: its observation is a `base.GoalObs`. Its `step` rests where the episode is over; for a
        flat baseline it begins a new one there, see `envs.wrappers.AutoReset`.
      num_actions: size A of the robot's controls.
      side_xy: the arena's sides in units, its upper left corner at the origin.
      episode_steps: control steps of the longest episode.
      mesh: devices over which environments, replays and batches are sharded; None: one device.
    """

    env: base.Environment
    num_actions: int
    side_xy: tuple[int, int]
    episode_steps: int
    mesh: jax.sharding.Mesh | None = None

    def reset(self, num_envs: int, key: Key[Array, ""]) -> base.EnvState:
        """Begins an episode in each of N environments."""
        return self._begin(jax.random.split(key, num_envs))

    def step(self, envs: base.EnvState, ctrl: Float[Array, "N nu"]) -> base.EnvState:
        """Steps every environment; the controls are in [-1, 1]."""
        # Each device calls the physics for its own robots.
        return self.on_each_device(jax.vmap(self.env.step))(envs, ctrl)

    def renew(self, envs: base.EnvState, is_over: Bool[Array, " N"]) -> base.EnvState:
        """Begins a new episode, drawn anew, where `is_over`."""
        # All are drawn anew, and most draws dropped: shapes can't depend on who is done.
        return jax.vmap(tree.where)(is_over, self._begin(envs.key), envs)

    def on_each_device(self, function: Callable[..., OutT]) -> Callable[..., OutT]:
        """Returns a function whose arguments and results are sharded by their leading axes."""
        return devices.over_devices(function, self.mesh)

    def draw(self, stored: replay.Replay, shape: tuple[int, int], key: Key[Array, ""]) -> Any:
        """Draws U batches of B stored rows, sharded by their rows."""
        return self.shard(replay.sample(stored, shape, key), axis=1)

    def shard(self, batches: TreeT, axis: int) -> TreeT:
        """Shards batches by the axis along which their rows lie."""
        return devices.shard(batches, axis, self.mesh)

    def num_features(self, see: Callable[[base.GoalObs], Float[Array, " F"]]) -> int:
        """Returns the size F of what a function makes of an observation."""
        # Only shapes are traced: no episode begins for them.
        return jax.eval_shape(lambda key: see(self.env.reset(key).obs), jax.random.key(0)).shape[0]

    def centred(self, xy: Float[Array, "*B 2"]) -> Float[Array, "*B 2"]:
        """Returns positions relative to the arena's centre, units."""
        # The origin is the upper left corner and y points up: the centre lies below it.
        centre = jnp.array([self.side_xy[0] / 2.0, -self.side_xy[1] / 2.0])
        return xy - jnp.broadcast_to(centre, xy.shape)

    def _begin(self, keys: Key[Array, " N"]) -> base.EnvState:
        return self.on_each_device(jax.vmap(self.env.reset))(keys)
