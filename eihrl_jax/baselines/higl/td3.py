"""TD3 as the levels of HIGL have it: both critics on one target, the actor at every update.

Fujimoto et al. 2018, Addressing function approximation error in actor-critic methods, Algorithm 1,
with the Huber loss and without the delay of the actor (released code of HIRO, HRAC and HIGL).
"""

from collections.abc import Callable
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.baselines.actor_critic import ActorCritic, ActorCriticState, Loss, Metrics
from eihrl_jax.config import higl as config_lib
from eihrl_jax.networks import mlp

Penalty: TypeAlias = Callable[[Float[Array, "B A"]], Float[Array, ""]]
"""A term of the actor's loss: from the actions that it would take to a number."""


class Td3(ActorCritic):
    """The functions of one level; holds no state."""

    def __init__(self, num_features: int, num_actions: int, options: config_lib.Td3):
        """Builds networks and optimisers.

        Args:
          num_features: size F of the input.
          num_actions: size A of the action.
          options: hyper-parameters.
        """
        super().__init__(
            (num_features, num_actions),
            mlp.Actor(options.hidden, num_actions, options.reach),
            mlp.Critic(options.hidden),
            2,
            optax.adam(options.actor_rate),
            # The decay joins the gradient before Adam, which makes it L2 regularisation.
            optax.chain(
                optax.add_decayed_weights(options.critic_decay), optax.adam(options.critic_rate)
            ),
        )

        self.options = options

    def act(self, actor_params: base.Params, obs: Float[Array, "*B F"]) -> Float[Array, "*B A"]:
        """Returns the actions of the policy, each entry within the level's reach."""
        return cast(Array, self._actor.apply({"params": actor_params}, obs))

    def explore(self, action: Float[Array, "*B A"], key: Key[Array, ""]) -> Float[Array, "*B A"]:
        """Returns actions with noise, within the reach."""
        noise = self.options.noise * jax.random.normal(key, action.shape)
        return self._within_reach(action + noise)

    def update(
        self,
        state: ActorCriticState,
        batch: base.Transition,
        weight: Float[Array, " B"],
        key: Key[Array, ""],
        penalty: Penalty | None = None,
    ) -> tuple[ActorCriticState, Metrics]:
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

        def critic_loss(params: base.Params) -> Loss:
            values = self.values(params, batch.obs, batch.action)
            losses = optax.huber_loss(values, jnp.broadcast_to(target, values.shape))
            loss = (weight * losses.sum(0)).mean()
            return loss, {"critic_loss": loss, "value": values.mean()}

        def actor_loss(params: base.Params, critic_params: base.Params) -> Loss:
            action = self.act(params, batch.obs)
            # Fujimoto et al. 2018, Algorithm 1: the actor follows the first critic alone.
            first = self.values(critic_params[:1], batch.obs, action)[0]
            extra = jnp.float32(0.0) if penalty is None else penalty(action)
            loss = -(weight * first).mean() + extra
            return loss, {"actor_loss": loss}

        return self.improve(state, critic_loss, actor_loss, self.options.target_rate)

    def _target(
        self, state: ActorCriticState, batch: base.Transition, key: Key[Array, ""]
    ) -> Float[Array, " B"]:
        """Returns r + discount * min_i Q_i(s', a') of the averages, a' with clipped noise."""
        options = self.options
        action = self.act(state.target_actor_params, batch.next_obs)
        # Fujimoto et al. 2018: noise smooths the target over actions that are nearly the same.
        noise = options.target_noise * jax.random.normal(key, action.shape)
        noise = jnp.clip(noise, -options.target_clip, options.target_clip)
        action = self._within_reach(action + noise)
        values = self.values(state.target_critic_params, batch.next_obs, action)
        return batch.reward + batch.discount * values.min(0)

    def _within_reach(self, action: Float[Array, "*B A"]) -> Float[Array, "*B A"]:
        return jnp.clip(action, -self.options.reach, self.options.reach)
