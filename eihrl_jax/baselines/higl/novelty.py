"""HIGL's novelty: how badly a network predicts another one, and the places where it was worst.

Burda et al. 2019, Exploration by random network distillation; Kim et al. 2021, Landmark-guided
subgoal generation in hierarchical reinforcement learning, Sec. 4.2.
"""

from typing import cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.config import higl as config_lib
from eihrl_jax.networks import mlp

NUM_FEATURES = 128
"""Outputs of both networks."""


class NoveltyState(struct.PyTreeNode):
    """The networks, and the M most novel places. F: size of what is seen.

    Attributes:
      target_params: of the network that is predicted, never learned.
      network: the one that predicts.
      obs: float32 [M, F], what was seen at the places; its first two entries are x and y, units.
      score: float32 [M], how novel they were when they were visited; -inf: no place yet.
    """

    target_params: base.Params
    network: optimisation.TrainState
    obs: Float[Array, "M F"]
    score: Float[Array, " M"]


class Novelty:
    """The functions of networks and queue; holds no state."""

    def __init__(self, num_features: int, options: config_lib.Landmarks):
        """Builds network and optimiser.

        Args:
          num_features: size F of what is seen.
          options: sizes and numbers.
        """
        self._num_features = num_features
        self._options = options
        self._network = mlp.Mlp(options.novelty_hidden, NUM_FEATURES)
        self._optimizer = optax.adam(options.novelty_rate)

    def init(self, key: Key[Array, ""]) -> NoveltyState:
        """Draws both networks; there is no place yet."""
        target_key, own_key = jax.random.split(key)
        obs, num = jnp.zeros(self._num_features), self._options.num_novel
        params = self._network.init(own_key, obs)["params"]
        # Burda et al. 2019: the target stays as drawn, so that only visits make it predictable.
        return NoveltyState(
            target_params=self._network.init(target_key, obs)["params"],
            network=optimisation.init(self._optimizer, params),
            obs=jnp.zeros((num, self._num_features)),
            score=jnp.full(num, -jnp.inf, jnp.float32),
        )

    def visit(
        self,
        state: NoveltyState,
        obs: Float[Array, "V F"],
        is_valid: Bool[Array, " V"],
    ) -> NoveltyState:
        """Puts visited places among the most novel ones.

        A place in the queue that a visit comes nearer to than `merge_radius` is dropped: it is no
        longer as novel as it was. Of visits as near to each other the most novel one stays.
        """
        # Places are told apart by x and y, whatever else was seen there.
        square = jnp.square(state.obs[:, None, :2] - obs[None, :, :2]).sum(-1)
        radius = self._options.merge_radius**2
        is_seen_again = ((square < radius) & is_valid[None]).any(1)
        kept = jnp.where(is_seen_again, -jnp.inf, state.score)

        # Only visits are scored by the networks of now: the queue keeps its scores of then.
        errors = self._errors(state.network.params, state.target_params, obs)
        new = jnp.where(is_valid, errors, -jnp.inf)
        every_obs = jnp.concatenate([state.obs, obs])
        every_xy = every_obs[:, :2]

        # The most novel first, each taking what lies near to it along: the released code keeps all
        # new ones, which may then lie together.
        def pick(
            score: Float[Array, " A"], _: None
        ) -> tuple[Float[Array, " A"], tuple[Int[Array, ""], Float[Array, ""]]]:
            index = jnp.argmax(score).astype(jnp.int32)
            is_near = jnp.square(every_xy - every_xy[index][None]).sum(-1) < radius
            # With a radius of 0 nothing is near, not even the place itself.
            left = jnp.where(is_near, -jnp.inf, score).at[index].set(-jnp.inf)
            return left, (index, score[index])

        score = jnp.concatenate([kept, new])
        _, (index, best) = jax.lax.scan(pick, score, length=state.score.shape[0])
        return state.replace(obs=every_obs[index], score=best)

    def update(
        self, state: NoveltyState, obs: Float[Array, "B F"]
    ) -> tuple[NoveltyState, Float[Array, ""]]:
        """Learns to predict what was seen; returns the loss too."""

        def loss_fn(params: base.Params) -> tuple[Float[Array, ""], Float[Array, ""]]:
            loss = self._errors(params, state.target_params, obs).mean()
            return loss, loss

        network, loss = optimisation.minimise(self._optimizer, loss_fn, state.network)
        return state.replace(network=network), loss

    def _errors(
        self, params: base.Params, target_params: base.Params, obs: Float[Array, "B F"]
    ) -> Float[Array, " B"]:
        """Returns half the squared distance of prediction and target, the novelty."""
        predicted, target = (
            cast(Array, self._network.apply({"params": each}, obs))
            for each in (params, target_params)
        )
        return 0.5 * jnp.square(predicted - target).sum(-1)
