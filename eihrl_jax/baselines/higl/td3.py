"""TD3 as the levels of HIGL have it: both critics on one target, the actor at every update.

Fujimoto et al. 2018, Addressing function approximation error in actor-critic methods, Algorithm 1,
with the Huber loss and without the delay of the actor (released code of HIRO, HRAC and HIGL).
"""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.config import higl as config_lib
from eihrl_jax.networks import mlp

Penalty = Callable[[Float[Array, "B A"]], Float[Array, ""]]
"""A term of the actor's loss: from the actions that it would take to a number."""


class Td3State(struct.PyTreeNode):
    """All that a level learns with.

    Attributes:
      actor_params: of `networks.mlp.Actor`.
      critic_params: of two `networks.mlp.Critic`s, a tuple.
      target_actor_params: moving average of `actor_params`.
      target_critic_params: moving average of `critic_params`.
      actor_opt_state: of Adam.
      critic_opt_state: of Adam.
    """

    actor_params: Any
    critic_params: Any
    target_actor_params: Any
    target_critic_params: Any
    actor_opt_state: optax.OptState
    critic_opt_state: optax.OptState


class Td3:
    """The functions of one level; holds no state."""

    def __init__(self, num_features: int, num_actions: int, options: config_lib.Td3):
        """Builds networks and optimisers.

        Args:
          num_features: size F of the input.
          num_actions: size A of the action.
          options: hyper-parameters.
        """
        self.options = options
        self.num_actions = num_actions
        self._num_features = num_features
        self._actor = mlp.Actor(options.hidden, num_actions, options.reach)
        self._critic = mlp.Critic(options.hidden)
        self._actor_optimizer = optax.adam(options.actor_rate)
        self._critic_optimizer = optax.chain(
            optax.add_decayed_weights(options.critic_decay), optax.adam(options.critic_rate)
        )

    def init(self, key: Key[Array, ""]) -> Td3State:
        """Draws all parameters."""
        actor_key, *critic_keys = jax.random.split(key, 3)
        obs, action = jnp.zeros(self._num_features), jnp.zeros(self.num_actions)
        actor_params = self._actor.init(actor_key, obs)["params"]
        critic_params = tuple(
            self._critic.init(one_key, obs, action)["params"] for one_key in critic_keys
        )
        return Td3State(
            actor_params=actor_params,
            critic_params=critic_params,
            target_actor_params=actor_params,
            target_critic_params=critic_params,
            actor_opt_state=self._actor_optimizer.init(actor_params),
            critic_opt_state=self._critic_optimizer.init(critic_params),
        )

    def act(self, actor_params: Any, obs: Float[Array, "*B F"]) -> Float[Array, "*B A"]:
        """Returns the actions of the policy, each entry within the level's reach."""
        return cast(Array, self._actor.apply({"params": actor_params}, obs))

    def explore(self, action: Float[Array, "*B A"], key: Key[Array, ""]) -> Float[Array, "*B A"]:
        """Returns actions with noise, within the reach."""
        noise = self.options.noise * jax.random.normal(key, action.shape)
        return self._within_reach(action + noise)

    def values(
        self, critic_params: Any, obs: Float[Array, "*B F"], action: Float[Array, "*B A"]
    ) -> Float[Array, "2 *B"]:
        """Returns both critics' values; unrolled, faster than batched on CPU."""
        return jnp.stack(
            [
                cast(Array, self._critic.apply({"params": params}, obs, action))
                for params in critic_params
            ]
        )

    def update(
        self,
        state: Td3State,
        batch: base.Transition,
        weight: Float[Array, " B"],
        key: Key[Array, ""],
        penalty: Penalty | None = None,
    ) -> tuple[Td3State, dict[str, Float[Array, ""]]]:
        """Updates critics, actor and their averages once.

        Args:
          state: where the learner is.
          batch: transitions with leading axis B.
          weight: float32 [B], how much each counts.
          key: consumed.
          penalty: added to the actor's loss.

        Returns:
          The new state, and scalars: losses, mean value.
        """
        target = self._target(state, batch, key)

        def critic_loss(critic_params: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
            values = self.values(critic_params, batch.obs, batch.action)
            losses = optax.huber_loss(values, jnp.broadcast_to(target, values.shape))
            return (weight * losses.sum(0)).mean(), values.mean()

        (loss, value), grads = jax.value_and_grad(critic_loss, has_aux=True)(state.critic_params)
        critic_params, critic_opt_state = optimisation.step(
            self._critic_optimizer, grads, state.critic_opt_state, state.critic_params
        )

        def actor_loss(actor_params: Any) -> Float[Array, ""]:
            action = self.act(actor_params, batch.obs)
            first = cast(Array, self._critic.apply({"params": critic_params[0]}, batch.obs, action))
            extra = jnp.float32(0.0) if penalty is None else penalty(action)
            return -(weight * first).mean() + extra

        actor_cost, grads = jax.value_and_grad(actor_loss)(state.actor_params)
        actor_params, actor_opt_state = optimisation.step(
            self._actor_optimizer, grads, state.actor_opt_state, state.actor_params
        )
        rate = self.options.target_rate
        state = Td3State(
            actor_params=actor_params,
            critic_params=critic_params,
            target_actor_params=optax.incremental_update(
                actor_params, state.target_actor_params, rate
            ),
            target_critic_params=optax.incremental_update(
                critic_params, state.target_critic_params, rate
            ),
            actor_opt_state=actor_opt_state,
            critic_opt_state=critic_opt_state,
        )
        return state, {"critic_loss": loss, "actor_loss": actor_cost, "value": value}

    def _target(
        self, state: Td3State, batch: base.Transition, key: Key[Array, ""]
    ) -> Float[Array, " B"]:
        """Returns r + discount * min_i Q_i(s', a') of the averages, a' with clipped noise."""
        options = self.options
        action = self.act(state.target_actor_params, batch.next_obs)
        noise = options.target_noise * jax.random.normal(key, action.shape)
        noise = jnp.clip(noise, -options.target_clip, options.target_clip)
        action = self._within_reach(action + noise)
        values = self.values(state.target_critic_params, batch.next_obs, action)
        return batch.reward + batch.discount * values.min(0)

    def _within_reach(self, action: Float[Array, "*B A"]) -> Float[Array, "*B A"]:
        return jnp.clip(action, -self.options.reach, self.options.reach)
