"""The two levels of HESS: soft actor-critic above, deterministic policy gradients below.

Haarnoja et al. 2018 (SAC) with a fixed temperature; Lillicrap et al. 2016 (DDPG) with a critic that
tells a time: its output d, in control steps, means the value -(1 - gamma^d) / (1 - gamma).
"""

import math
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.config import hess as config_lib
from eihrl_jax.networks import droq, mlp
from eihrl_jax.ops import tanh_normal


class LevelState(struct.PyTreeNode):
    """All that a level learns with.

    Attributes:
      actor_params: of its policy.
      critic_params: of its critics.
      target_actor_params: moving average of `actor_params`; not used above.
      target_critic_params: moving average of `critic_params`.
      actor_opt_state: of Adam.
      critic_opt_state: of Adam.
      num_updates: int32, updates so far.
    """

    actor_params: Any
    critic_params: Any
    target_actor_params: Any
    target_critic_params: Any
    actor_opt_state: optax.OptState
    critic_opt_state: optax.OptState
    num_updates: Int[Array, ""]


class Sac:
    """The upper level; actions lie within `reach` of zero, and so critics see them."""

    def __init__(
        self,
        num_features: int,
        num_actions: int,
        options: config_lib.Sac,
        value_floor: float | None = None,
    ):
        """Builds networks and optimiser for F features and A actions.

        Args:
          num_features: F.
          num_actions: A.
          options: hyper-parameters.
          value_floor: targets are clipped to between this and 0; None: they aren't.
        """
        self.options = options
        self._value_floor = value_floor
        self._num_features, self._num_actions = num_features, num_actions
        self._actor = droq.Actor(num_actions, options.hidden)
        self._critic = mlp.Critic(options.hidden)
        self._optimizer = optax.adam(options.learning_rate)

    def init(self, key: Key[Array, ""]) -> LevelState:
        """Draws all parameters."""
        actor_key, *critic_keys = jax.random.split(key, 3)
        obs, action = jnp.zeros(self._num_features), jnp.zeros(self._num_actions)
        actor_params = self._actor.init(actor_key, obs)["params"]
        critics = tuple(self._critic.init(each, obs, action)["params"] for each in critic_keys)
        return LevelState(
            actor_params=actor_params,
            critic_params=critics,
            target_actor_params=actor_params,
            target_critic_params=critics,
            actor_opt_state=self._optimizer.init(actor_params),
            critic_opt_state=self._optimizer.init(critics),
            num_updates=jnp.int32(0),
        )

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
        state: LevelState,
        batch: base.Transition,
        weight: Float[Array, " B"],
        key: Key[Array, ""],
    ) -> tuple[LevelState, dict[str, Float[Array, ""]]]:
        """Updates critics, actor and the critics' averages once; `weight`: how much each counts."""
        next_key, own_key = jax.random.split(key)
        options = self.options
        action, log_prob = self._sample(state.actor_params, batch.next_obs, next_key)
        soft = self._values(state.target_critic_params, batch.next_obs, action).min(0)
        target = batch.reward + batch.discount * (soft - options.temperature * log_prob)
        if self._value_floor is not None:
            target = jnp.clip(target, self._value_floor, 0.0)

        def critic_loss(params: Any) -> Float[Array, ""]:
            values = self._values(params, batch.obs, batch.action)
            return (weight[None] * jnp.square(values - target[None])).mean(-1).sum()

        loss, grads = jax.value_and_grad(critic_loss)(state.critic_params)
        critics, critic_opt_state = optimisation.step(
            self._optimizer, grads, state.critic_opt_state, state.critic_params
        )

        def actor_loss(params: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
            action, log_prob = self._sample(params, batch.obs, own_key)
            values = self._values(critics, batch.obs, action).min(0)
            return (weight * (options.temperature * log_prob - values)).mean(), values.mean()

        (_, value), grads = jax.value_and_grad(actor_loss, has_aux=True)(state.actor_params)
        actor_params, actor_opt_state = optimisation.step(
            self._optimizer, grads, state.actor_opt_state, state.actor_params
        )
        averaged = optax.incremental_update(
            critics, state.target_critic_params, options.target_rate
        )
        state = LevelState(
            actor_params=actor_params,
            critic_params=critics,
            target_actor_params=actor_params,
            target_critic_params=averaged,
            actor_opt_state=actor_opt_state,
            critic_opt_state=critic_opt_state,
            num_updates=state.num_updates + 1,
        )
        return state, {"critic_loss": loss, "value": value}

    def _squashed(self, params: Any, obs: Float[Array, "*B F"]) -> tuple[Array, Array]:
        return cast(tuple[Array, Array], self._actor.apply({"params": params}, obs))

    def _sample(
        self, params: Any, obs: Float[Array, "*B F"], key: Key[Array, ""]
    ) -> tuple[Float[Array, "*B A"], Float[Array, "*B"]]:
        """Draws actions within the reach; returns the logarithms of their densities too."""
        mean, log_std = self._squashed(params, obs)
        action, log_prob = tanh_normal.sample(mean, log_std, key)
        reach = self.options.reach
        return reach * action, log_prob - self._num_actions * math.log(reach)

    def _values(
        self, params: Any, obs: Float[Array, "B F"], action: Float[Array, "B A"]
    ) -> Float[Array, "2 B"]:
        return jnp.stack(
            [cast(Array, self._critic.apply({"params": each}, obs, action)) for each in params]
        )


class Ddpg:
    """The lower level; actions in [-1, 1]."""

    def __init__(self, num_features: int, num_actions: int, options: config_lib.Ddpg):
        """Builds networks and optimisers for F features and A actions."""
        self.options = options
        self._num_features, self._num_actions = num_features, num_actions
        self._actor = mlp.Actor(options.hidden, num_actions)
        self._critic = mlp.Critic(options.critic_hidden)
        clip = optax.clip_by_global_norm(options.max_grad_norm)
        adam = optax.adam(options.learning_rate)
        decay = optax.add_decayed_weights(options.critic_decay)
        self._actor_optimizer = optax.chain(clip, adam)
        self._critic_optimizer = optax.chain(clip, decay, adam)

    def init(self, key: Key[Array, ""]) -> LevelState:
        """Draws all parameters."""
        actor_key, critic_key = jax.random.split(key)
        obs, action = jnp.zeros(self._num_features), jnp.zeros(self._num_actions)
        actor_params = self._actor.init(actor_key, obs)["params"]
        critic_params = self._critic.init(critic_key, obs, action)["params"]
        return LevelState(
            actor_params=actor_params,
            critic_params=critic_params,
            target_actor_params=actor_params,
            target_critic_params=critic_params,
            actor_opt_state=self._actor_optimizer.init(actor_params),
            critic_opt_state=self._critic_optimizer.init(critic_params),
            num_updates=jnp.int32(0),
        )

    def act(self, actor_params: Any, obs: Float[Array, "*B F"]) -> Float[Array, "*B A"]:
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
        state: LevelState,
        batch: base.Transition,
        weight: Float[Array, " B"],
        rate: Float[Array, ""],
    ) -> tuple[LevelState, dict[str, Float[Array, ""]]]:
        """Updates critic and actor once, and their averages every few times.

        Args:
          state: where the level is.
          batch: transitions with leading axis B.
          weight: float32 [B], how much each counts.
          rate: share of the learning rate that is left.
        """
        action = self.act(state.target_actor_params, batch.next_obs)
        following = self._value(state.target_critic_params, batch.next_obs, action)
        target = jnp.minimum(batch.reward + batch.discount * following, 0.0)

        def critic_loss(params: Any) -> tuple[Float[Array, ""], Float[Array, ""]]:
            values = self._value(params, batch.obs, batch.action)
            return (weight * jnp.square(values - target)).mean(), values.mean()

        (loss, value), grads = jax.value_and_grad(critic_loss, has_aux=True)(state.critic_params)
        critic_params, critic_opt_state = optimisation.step(
            self._critic_optimizer, grads, state.critic_opt_state, state.critic_params, rate
        )

        def actor_loss(params: Any) -> Float[Array, ""]:
            values = self._value(critic_params, batch.obs, self.act(params, batch.obs))
            return -(weight * values).mean()

        grads = jax.grad(actor_loss)(state.actor_params)
        actor_params, actor_opt_state = optimisation.step(
            self._actor_optimizer, grads, state.actor_opt_state, state.actor_params, rate
        )
        num_updates = state.num_updates + 1
        is_due = num_updates % self.options.target_period == 0
        step = jnp.where(is_due, self.options.target_rate, 0.0)
        state = LevelState(
            actor_params=actor_params,
            critic_params=critic_params,
            target_actor_params=optax.incremental_update(
                actor_params, state.target_actor_params, step
            ),
            target_critic_params=optax.incremental_update(
                critic_params, state.target_critic_params, step
            ),
            actor_opt_state=actor_opt_state,
            critic_opt_state=critic_opt_state,
            num_updates=num_updates,
        )
        return state, {"critic_loss": loss, "value": value}

    def _value(
        self, params: Any, obs: Float[Array, "B F"], action: Float[Array, "B A"]
    ) -> Float[Array, " B"]:
        """Returns -(1 - gamma^d) / (1 - gamma) of the critic's d."""
        steps = cast(Array, self._critic.apply({"params": params}, obs, action))
        gamma = self.options.gamma
        return -(1.0 - gamma**steps) / (1.0 - gamma)
