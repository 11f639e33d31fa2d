"""What the levels of HIGL and HESS share: networks, averages, optimisers."""

from collections.abc import Callable
from typing import TypeAlias, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation

Metrics: TypeAlias = dict[str, Float[Array, ""]]

Loss: TypeAlias = tuple[Float[Array, ""], Metrics]
"""A loss, and metrics beside it."""


class ActorCriticState(struct.PyTreeNode):
    """All that a level learns with.

    Attributes:
      actor: the policy's network.
      critics: the critics' networks, their parameters a tuple.
      target_actor_params: moving average of the actor's; SAC's targets don't need it.
      target_critic_params: moving average of the critics'.
      num_updates: int32, updates so far.
    """

    actor: optimisation.TrainState
    critics: optimisation.TrainState
    target_actor_params: base.Params
    target_critic_params: base.Params
    num_updates: Int[Array, ""]


class ActorCritic:
    """Networks and optimisers of a level; TD3, SAC and DDPG add their losses. Holds no state."""

    def __init__(
        self,
        sizes: tuple[int, int],
        actor: nn.Module,
        critic: nn.Module,
        num_critics: int,
        actor_optimizer: optax.GradientTransformation,
        critic_optimizer: optax.GradientTransformation,
    ):
        """Takes what a level is made of.

        Args:
          sizes: F of the input and A of the action.
          actor: maps observations to actions, or to what actions are drawn from.
          critic: maps observations and actions to values.
          num_critics: M.
          actor_optimizer: of the actor.
          critic_optimizer: of all critics together.
        """
        self._sizes = sizes
        self._actor, self._critic, self._num_critics = actor, critic, num_critics
        self._actor_optimizer = actor_optimizer
        self._critic_optimizer = critic_optimizer

    def init(self, key: Key[Array, ""]) -> ActorCriticState:
        """Draws all parameters."""
        # Each critic is drawn anew: two alike would learn alike, their minimum being either.
        actor_key, *critic_keys = jax.random.split(key, 1 + self._num_critics)
        obs, action = map(jnp.zeros, self._sizes)
        actor_params = self._actor.init(actor_key, obs)["params"]
        critic_params = tuple(self._critic.init(k, obs, action)["params"] for k in critic_keys)
        return ActorCriticState(
            actor=optimisation.init(self._actor_optimizer, actor_params),
            critics=optimisation.init(self._critic_optimizer, critic_params),
            target_actor_params=actor_params,
            target_critic_params=critic_params,
            num_updates=jnp.int32(0),
        )

    def values(
        self, critic_params: base.Params, obs: Float[Array, "*B F"], action: Float[Array, "*B A"]
    ) -> Float[Array, "M *B"]:
        """Returns the values of every critic; unrolled, faster than batched on CPU."""
        return jnp.stack(
            [
                cast(Array, self._critic.apply({"params": params}, obs, action))
                for params in critic_params
            ]
        )

    def improve(
        self,
        state: ActorCriticState,
        critic_loss: Callable[[base.Params], Loss],
        actor_loss: Callable[[base.Params, base.Params], Loss],
        target_rate: Float[Array, ""] | float,
        rate: Float[Array, ""] | float = 1.0,
    ) -> tuple[ActorCriticState, Metrics]:
        """Takes a step down both losses, then moves the averages.

        Args:
          state: where the level is.
          critic_loss: of the critics' parameters.
          actor_loss: of the actor's parameters and the critics' new ones.
          target_rate: tau, by which the averages move.
          rate: share of the learning rate that is left.

        Returns:
          The new state, and the metrics of both losses.
        """
        critics, metrics = optimisation.minimise(
            self._critic_optimizer, critic_loss, state.critics, rate
        )

        # The actor follows the critics as they are now.
        actor, actor_metrics = optimisation.minimise(
            self._actor_optimizer,
            lambda params: actor_loss(params, critics.params),
            state.actor,
            rate,
        )

        # A rate of 0 leaves the averages where they are: HESS's controller moves them now and then.
        state = ActorCriticState(
            actor=actor,
            critics=critics,
            target_actor_params=optax.incremental_update(
                actor.params, state.target_actor_params, target_rate
            ),
            target_critic_params=optax.incremental_update(
                critics.params, state.target_critic_params, target_rate
            ),
            num_updates=state.num_updates + 1,
        )
        return state, metrics | actor_metrics
