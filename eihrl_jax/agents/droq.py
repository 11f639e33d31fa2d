"""DroQ: soft actor-critic with few dropout critics and many updates, as pure functions.

Hiraoka et al. 2021, Dropout Q-functions for doubly efficient reinforcement learning, Algorithm 2.
Dropout is on in the online critics, the target critics and the actor's loss; the actor follows the
mean of the critics, the target their minimum.
"""

from typing import cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.config import low as low_config
from eihrl_jax.networks import droq as networks
from eihrl_jax.ops import tanh_normal


class DroqState(struct.PyTreeNode):
    """Parameters and optimisers of the learner.

    Attributes:
      actor_params: of `networks.droq.Actor`.
      average_params: moving average of `actor_params`, which acts without exploration.
      critic_params: of M `networks.droq.Critic`s, a tuple.
      target_params: moving average of `critic_params`.
      log_temperature: float32, log alpha.
      actor_opt_state: of Adam.
      critic_opt_state: of Adam.
      temperature_opt_state: of Adam.
      num_updates: int32, critic updates so far.
    """

    actor_params: base.Params
    average_params: base.Params
    critic_params: base.Params
    target_params: base.Params
    log_temperature: Float[Array, ""]
    actor_opt_state: optax.OptState
    critic_opt_state: optax.OptState
    temperature_opt_state: optax.OptState
    num_updates: Int[Array, ""]


class Droq:
    """The learner's functions for one size of observation and action; holds no state."""

    def __init__(self, num_features: int, num_actions: int, options: low_config.Droq):
        """Builds networks and optimisers.

        Args:
          num_features: size F of the network's input.
          num_actions: size A of the action.
          options: hyper-parameters.
        """
        self.options = options
        self._num_features = num_features
        self._actor = networks.Actor(num_actions, options.hidden)
        self._critic = networks.Critic(options.hidden, options.dropout)
        self._optimizer = optax.adam(options.learning_rate)
        self._num_actions = num_actions

    def init(self, key: Key[Array, ""]) -> DroqState:
        """Draws all parameters."""
        actor_key, critic_key, dropout_key = jax.random.split(key, 3)
        # Networks of batches: dropout draws its masks for all rows at once.
        obs = jnp.zeros((1, self._num_features))
        action = jnp.zeros((1, self._num_actions))
        actor_params = self._actor.init(actor_key, obs)["params"]
        critic_params = tuple(
            self._critic.init(one_key, obs, action, dropout_key)["params"]
            for one_key in jax.random.split(critic_key, self.options.num_critics)
        )

        # The logarithm is learned, so that the temperature stays positive.
        log_temperature = jnp.log(jnp.float32(self.options.temperature))
        return DroqState(
            actor_params=actor_params,
            average_params=actor_params,
            critic_params=critic_params,
            target_params=critic_params,
            log_temperature=log_temperature,
            actor_opt_state=self._optimizer.init(actor_params),
            critic_opt_state=self._optimizer.init(critic_params),
            temperature_opt_state=self._optimizer.init(log_temperature),
            num_updates=jnp.int32(0),
        )

    def sample(
        self, actor_params: base.Params, obs: Float[Array, " F"], key: Key[Array, ""]
    ) -> Float[Array, " A"]:
        """Draws an action in (-1, 1)."""
        mean, log_std = self._squashed(actor_params, obs)
        return tanh_normal.sample(mean, log_std, key)[0]

    def mode(self, actor_params: base.Params, obs: Float[Array, " F"]) -> Float[Array, " A"]:
        """Returns the squashed mean, in (-1, 1)."""
        return jnp.tanh(self._squashed(actor_params, obs)[0])

    def update(
        self, state: DroqState, batch: base.Transition, key: Key[Array, ""]
    ) -> tuple[DroqState, dict[str, Float[Array, ""]]]:
        """Updates the critics and their targets once, every `actor_period` times also the actor.

        Args:
          state: of the learner.
          batch: transitions with leading axis B.
          key: consumed.

        Returns:
          The new state, and scalars: losses, mean value, entropy, temperature.
        """
        # Hiraoka et al. 2021, Algorithm 2: G updates of the critics, then one of the actor; a call
        # is one of the G.
        critic_key, actor_key = jax.random.split(key)
        state, critic_metrics = self.update_critic(state, batch, critic_key)

        def skip(state: DroqState) -> tuple[DroqState, dict[str, Float[Array, ""]]]:
            nan = jnp.float32(jnp.nan)
            return state, {"actor_loss": nan, "entropy": nan}

        state, actor_metrics = jax.lax.cond(
            state.num_updates % self.options.actor_period == 0,
            lambda state: self.update_actor(state, batch, actor_key),
            skip,
            state,
        )
        temperature = jnp.exp(state.log_temperature)
        return state, critic_metrics | actor_metrics | {"temperature": temperature}

    def update_critic(
        self, state: DroqState, batch: base.Transition, key: Key[Array, ""]
    ) -> tuple[DroqState, dict[str, Float[Array, ""]]]:
        """Regresses every critic on one shared target, then moves the target critics."""
        # Hiraoka et al. 2021, Algorithm 2: one target y for all critics.
        target_key, online_key = jax.random.split(key)
        target = self._target(state, batch, target_key)

        def loss_fn(critic_params: base.Params) -> tuple[Float[Array, ""], Float[Array, ""]]:
            values = self.values(critic_params, batch.obs, batch.action, online_key)
            # Summed over the critics, so that each has the gradient that it would have alone.
            return jnp.square(values - target[None]).mean(-1).sum(), values.mean()

        (loss, value), grads = jax.value_and_grad(loss_fn, has_aux=True)(state.critic_params)
        critic_params, opt_state = self._step(
            grads, state.critic_opt_state, state.critic_params, state.num_updates
        )
        state = state.replace(
            critic_params=critic_params,
            critic_opt_state=opt_state,
            target_params=optax.incremental_update(
                critic_params, state.target_params, self.options.target_rate
            ),
            num_updates=state.num_updates + 1,
        )
        return state, {"critic_loss": loss, "value": value}

    def update_actor(
        self, state: DroqState, batch: base.Transition, key: Key[Array, ""]
    ) -> tuple[DroqState, dict[str, Float[Array, ""]]]:
        """Moves actor and temperature one step."""
        # Hiraoka et al. 2021, Algorithm 2: along the mean of the critics, not their minimum.
        action_key, dropout_key = jax.random.split(key)
        temperature = jnp.exp(state.log_temperature)

        def loss_fn(actor_params: base.Params) -> tuple[Float[Array, ""], Float[Array, ""]]:
            action, log_prob = self._sample(actor_params, batch.obs, action_key)
            values = self.values(state.critic_params, batch.obs, action, dropout_key)
            return (temperature * log_prob - values.mean(0)).mean(), -log_prob.mean()

        (loss, entropy), grads = jax.value_and_grad(loss_fn, has_aux=True)(state.actor_params)
        actor_params, actor_opt_state = self._step(
            grads, state.actor_opt_state, state.actor_params, state.num_updates
        )

        # d/d(log alpha) of log_alpha * (entropy - target_entropy), as in the authors' code.
        temperature_grad = entropy - self.options.target_entropy * self._num_actions
        log_temperature, temperature_opt_state = self._step(
            temperature_grad,
            state.temperature_opt_state,
            state.log_temperature,
            state.num_updates,
        )

        state = state.replace(
            actor_params=actor_params,
            average_params=optax.incremental_update(
                actor_params, state.average_params, self.options.average_rate
            ),
            actor_opt_state=actor_opt_state,
            log_temperature=log_temperature,
            temperature_opt_state=temperature_opt_state,
        )
        return state, {"actor_loss": loss, "entropy": entropy}

    def _step(
        self,
        grads: base.Params,
        opt_state: optax.OptState,
        params: base.Params,
        num_updates: Int[Array, ""],
    ) -> tuple[base.Params, optax.OptState]:
        """Takes one step of Adam at the current learning rate."""
        half_life = self.options.learning_rate_half_life
        if half_life is None:
            return optimisation.step(self._optimizer, grads, opt_state, params)
        # Adam's updates are proportional to the rate, so its state needs no schedule.
        share = jnp.exp2(-num_updates.astype(jnp.float32) / half_life)
        return optimisation.step(self._optimizer, grads, opt_state, params, share)

    def _target(
        self, state: DroqState, batch: base.Transition, key: Key[Array, ""]
    ) -> Float[Array, " B"]:
        """Returns r + discount * (min_i Q_i(s', a') - alpha log pi(a' | s')), fresh dropout."""
        action_key, dropout_key = jax.random.split(key)
        action, log_prob = self._sample(state.actor_params, batch.next_obs, action_key)
        # The target critics drop units as well.
        values = self.values(state.target_params, batch.next_obs, action, dropout_key)
        soft_value = values.min(0) - jnp.exp(state.log_temperature) * log_prob
        return batch.reward + batch.discount * soft_value

    def _squashed(
        self, actor_params: base.Params, obs: Float[Array, "*B F"]
    ) -> tuple[Array, Array]:
        """Returns mean and log standard deviation of the actions before they are squashed."""
        return cast(tuple[Array, Array], self._actor.apply({"params": actor_params}, obs))

    def _sample(
        self, actor_params: base.Params, obs: Float[Array, "B F"], key: Key[Array, ""]
    ) -> tuple[Float[Array, "B A"], Float[Array, " B"]]:
        mean, log_std = self._squashed(actor_params, obs)
        return tanh_normal.sample(mean, log_std, key)

    def values(
        self,
        critic_params: base.Params,
        obs: Float[Array, "B F"],
        action: Float[Array, "B A"],
        key: Key[Array, ""],
    ) -> Float[Array, "M B"]:
        """Returns every critic's values with dropout; unrolled: faster than `vmap` on CPU."""
        keys = jax.random.split(key, len(critic_params))
        return jnp.stack(
            [
                cast(Array, self._critic.apply({"params": params}, obs, action, one_key))
                for params, one_key in zip(critic_params, keys, strict=True)
            ]
        )
