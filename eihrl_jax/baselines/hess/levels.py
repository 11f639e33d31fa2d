"""The two levels of HESS: soft actor-critic above, deterministic policy gradients below.

Haarnoja et al. 2018 (SAC) with a fixed temperature; Lillicrap et al. 2016 (DDPG) with a critic
whose output is the time to the subgoal, see `networks.mlp.Critic`.
"""

import math
from typing import cast

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.baselines.actor_critic import ActorCritic, ActorCriticState, Loss, Metrics
from eihrl_jax.config import hess as config_lib
from eihrl_jax.networks import droq, mlp
from eihrl_jax.ops import tanh_normal


class Sac(ActorCritic):
    """The upper level; actions lie within `reach` of zero, and so critics see them."""

    def __init__(
        self,
        num_features: int,
        num_actions: int,
        options: config_lib.Sac,
        value_floor: float | None = None,
    ):
        """Builds networks and optimisers.

        Args:
          num_features: size F of the input.
          num_actions: size A of the action.
          options: hyper-parameters.
          value_floor: targets are clipped to between this and 0; None: they aren't.
        """
        adam = optax.adam(options.learning_rate)
        # The critics are drawn as PyTorch draws them; the released code draws Xavier's.
        actor, critic = droq.Actor(num_actions, options.hidden), mlp.Critic(options.hidden)
        super().__init__((num_features, num_actions), actor, critic, 2, adam, adam)
        self.options = options
        self.value_floor = value_floor

    def sample(
        self, actor_params: base.Params, obs: Float[Array, " F"], key: Key[Array, ""]
    ) -> Float[Array, " A"]:
        """Draws an action within the reach."""
        return self._sample(actor_params, obs, key)[0]

    def mode(self, actor_params: base.Params, obs: Float[Array, " F"]) -> Float[Array, " A"]:
        """Returns the squashed mean, within the reach."""
        return self.options.reach * jnp.tanh(self._squashed(actor_params, obs)[0])

    def update(
        self,
        state: ActorCriticState,
        batch: base.Transition,
        weight: Float[Array, " B"],
        key: Key[Array, ""],
    ) -> tuple[ActorCriticState, Metrics]:
        """Updates critics, actor and averages once; `weight` tells how much each row counts."""
        next_key, own_key = jax.random.split(key)
        temperature = self.options.temperature
        target = self._target(state, batch, next_key)

        def critic_loss(params: base.Params) -> Loss:
            values = self.values(params, batch.obs, batch.action)
            loss = (weight[None] * jnp.square(values - target[None])).mean(-1).sum()
            return loss, {"critic_loss": loss}

        def actor_loss(params: base.Params, critic_params: base.Params) -> Loss:
            action, log_prob = self._sample(params, batch.obs, own_key)
            # Unlike TD3's, SAC's actor follows the lesser of its critics, not the first one.
            values = self.values(critic_params, batch.obs, action).min(0)
            return (weight * (temperature * log_prob - values)).mean(), {"value": values.mean()}

        return self.improve(state, critic_loss, actor_loss, self.options.target_rate)

    def _target(
        self, state: ActorCriticState, batch: base.Transition, key: Key[Array, ""]
    ) -> Float[Array, " B"]:
        """Returns r + discount * (min_i Q_i(s', a') - alpha log pi(a' | s')), clipped if asked."""
        # The actor itself draws the next action: SAC's targets don't need its average.
        action, log_prob = self._sample(state.actor.params, batch.next_obs, key)
        values = self.values(state.target_critic_params, batch.next_obs, action).min(0)
        soft_value = values - self.options.temperature * log_prob
        target = batch.reward + batch.discount * soft_value
        return target if self.value_floor is None else jnp.clip(target, self.value_floor, 0.0)

    def _squashed(
        self, actor_params: base.Params, obs: Float[Array, "*B F"]
    ) -> tuple[Float[Array, "*B A"], Float[Array, "*B A"]]:
        """Returns mean and log standard deviation of the actions before they are squashed."""
        return cast(tuple[Array, Array], self._actor.apply({"params": actor_params}, obs))

    def _sample(
        self, actor_params: base.Params, obs: Float[Array, "*B F"], key: Key[Array, ""]
    ) -> tuple[Float[Array, "*B A"], Float[Array, "*B"]]:
        """Draws actions within the reach; returns the logarithms of their densities too."""
        action, log_prob = tanh_normal.sample(*self._squashed(actor_params, obs), key)
        reach = self.options.reach
        # Stretching by the reach divides the density by it along every axis.
        return reach * action, log_prob - action.shape[-1] * math.log(reach)


class Ddpg(ActorCritic):
    """The lower level; actions in [-1, 1]."""

    def __init__(self, num_features: int, num_actions: int, options: config_lib.Ddpg):
        """Builds networks and optimisers for F features and A actions."""
        clip = optax.clip_by_global_norm(options.max_grad_norm)
        adam = optax.adam(options.learning_rate)
        decay = optax.add_decayed_weights(options.critic_decay)

        # Decay joins the gradient after clipping and before Adam, which makes it L2 regularisation.
        super().__init__(
            (num_features, num_actions),
            mlp.Actor(options.hidden, num_actions),
            mlp.Critic(options.critic_hidden, options.gamma),
            1,
            optax.chain(clip, adam),
            optax.chain(clip, decay, adam),
        )
        self.options = options

    def act(self, actor_params: base.Params, obs: Float[Array, "*B F"]) -> Float[Array, "*B A"]:
        """Returns the actions of the policy."""
        return cast(Array, self._actor.apply({"params": actor_params}, obs))

    def explore(self, action: Float[Array, " A"], key: Key[Array, ""]) -> Float[Array, " A"]:
        """Returns an action with noise, or now and then any action at all."""
        noise_key, any_key, choice_key = jax.random.split(key, 3)
        noisy = action + self.options.noise * jax.random.normal(noise_key, action.shape)
        any_action = jax.random.uniform(any_key, action.shape, minval=-1.0, maxval=1.0)
        is_any = jax.random.bernoulli(choice_key, self.options.random_share)
        return jnp.where(is_any, any_action, jnp.clip(noisy, -1.0, 1.0))

    def update(
        self,
        state: ActorCriticState,
        batch: base.Transition,
        weight: Float[Array, " B"],
        rate: Float[Array, ""],
    ) -> tuple[ActorCriticState, Metrics]:
        """Updates critic and actor once, and their averages every few times.

        Args:
          state: where the level is.
          batch: transitions with leading axis B.
          weight: float32 [B], how much each counts.
          rate: share of the learning rate that is left.
        """
        action = self.act(state.target_actor_params, batch.next_obs)
        following = self.values(state.target_critic_params, batch.next_obs, action)[0]
        # A time can't be negative, nor a value positive.
        target = jnp.minimum(batch.reward + batch.discount * following, 0.0)

        def critic_loss(params: base.Params) -> Loss:
            values = self.values(params, batch.obs, batch.action)[0]
            loss = (weight * jnp.square(values - target)).mean()
            return loss, {"critic_loss": loss, "value": values.mean()}

        def actor_loss(params: base.Params, critic_params: base.Params) -> Loss:
            values = self.values(critic_params, batch.obs, self.act(params, batch.obs))[0]
            return -(weight * values).mean(), {}

        # Between their steps the averages move by a rate of 0.
        is_due = (state.num_updates + 1) % self.options.target_period == 0
        target_rate = jnp.where(is_due, self.options.target_rate, 0.0)
        return self.improve(state, critic_loss, actor_loss, target_rate, rate)
