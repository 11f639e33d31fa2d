"""HESS's representation: slow features of what is seen, kept stable where they already fit.

Li et al. 2021, Active hierarchical exploration with stable subgoal representation learning, Sec.
3.1: neighbours in time are drawn together, states a period apart pushed apart, and states whose
loss is low are anchored to where they were.
"""

import functools
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.baselines.hess.episodes import Episodes
from eihrl_jax.config import hess as config_lib
from eihrl_jax.networks import mlp

NUM_SUBGOAL = 2
"""Size of the subgoal space."""

StepIndex: TypeAlias = tuple[Int[Array, " B"], Int[Array, " B"]]
"""Stored steps: the numbers of their episodes, and of the steps in them."""


class RepresentationState(struct.PyTreeNode):
    """What the representation is learned with.

    Attributes:
      network: what embeds.
      num_blocks: int32, blocks of training so far.
      is_frozen: whether subgoals are reached so well that training has stopped.
    """

    network: optimisation.TrainState
    num_blocks: Int[Array, ""]
    is_frozen: Bool[Array, ""]


class Representation:
    """The functions of the network; holds no state."""

    def __init__(self, num_seen: int, options: config_lib.Representation):
        """Builds network and optimiser.

        Args:
          num_seen: size F of what is seen.
          options: sizes and numbers.
        """
        self.options = options
        self._num_seen = num_seen
        self._network = mlp.Mlp(options.hidden, NUM_SUBGOAL)
        self._optimizer = optax.adam(options.learning_rate)

    def init(self, key: Key[Array, ""]) -> RepresentationState:
        """Draws the parameters."""
        params = self._network.init(key, jnp.zeros(self._num_seen))["params"]
        return RepresentationState(
            network=optimisation.init(self._optimizer, params),
            num_blocks=jnp.int32(0),
            is_frozen=jnp.zeros((), bool),
        )

    def embed(self, params: base.Params, obs: Float[Array, "*B F"]) -> Float[Array, "*B 2"]:
        """Returns phi, where states lie in the subgoal space."""
        return cast(Array, self._network.apply({"params": params}, obs))

    def train(
        self,
        state: RepresentationState,
        episodes: Episodes,
        stability: Float[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[RepresentationState, Float[Array, "E T"], Float[Array, ""]]:
        """Trains a block of updates, anchored to the network of before it.

        Args:
          state: where the representation is.
          episodes: from which it learns.
          stability: weight of the anchors, lambda.
          key: consumed.

        Returns:
          The new state, the steps' losses now, and the mean loss.
        """
        before = state.network.params
        # Before the first block there is nothing that has to stay where it is.
        weight = jnp.where(state.num_blocks > 0, stability, 0.0)

        # Ranked once per block: losses that are found meanwhile count in the next one.
        tie_key, key = jax.random.split(key)
        order, num_usable = self._rank(episodes, tie_key)
        # The paper anchors the first ranks, the released code all but those.
        share = self.options.anchored_share * num_usable
        best = (jnp.float32(0.0), share) if self.options.anchors == "best" else (share, num_usable)

        def draw(ranks: tuple[Array, Array], key: Key[Array, ""]) -> StepIndex:
            first, end = ranks
            rank = first + jax.random.uniform(key, (self.options.batch_size,)) * (end - first)
            return jnp.divmod(order[rank.astype(jnp.int32)], episodes.loss.shape[1])

        def body(
            carry: tuple[optimisation.TrainState, Float[Array, "E T"]], key: Key[Array, ""]
        ) -> tuple[tuple[optimisation.TrainState, Float[Array, "E T"]], Float[Array, ""]]:
            network, losses = carry
            pair_key, anchor_key = jax.random.split(key)
            # Li et al. 2021, Sec. 3.1: the worse half of the steps teaches, the best ones hold.
            pair = draw((0.5 * num_usable, num_usable), pair_key)
            anchors = episodes.obs[draw(best, anchor_key)]
            loss_fn = functools.partial(
                self._loss, episodes, pair, anchors, self.embed(before, anchors), weight
            )
            network, (loss, contrast) = optimisation.minimise(self._optimizer, loss_fn, network)
            return (network, losses.at[pair].set(contrast)), loss

        keys = jax.random.split(key, self.options.num_updates)
        (network, losses), totals = jax.lax.scan(body, (state.network, episodes.loss), keys)
        state = state.replace(network=network, num_blocks=state.num_blocks + 1)
        return state, losses, totals.mean()

    def _loss(
        self,
        episodes: Episodes,
        pair: StepIndex,
        anchors: Float[Array, "B F"],
        held: Float[Array, "B 2"],
        stability: Float[Array, ""],
        params: base.Params,
    ) -> tuple[Float[Array, ""], tuple[Float[Array, ""], Float[Array, " B"]]]:
        """Returns the loss, and again with the contrastive one of each of the steps `pair`."""
        contrast = self._contrast(params, episodes, pair)
        drift = self.embed(params, anchors) - held
        loss = contrast.mean() + stability * jnp.square(drift).mean()
        return loss, (loss, contrast)

    def _contrast(
        self, params: base.Params, episodes: Episodes, steps: StepIndex
    ) -> Float[Array, " B"]:
        """Returns the contrastive loss of stored steps."""
        episode, step = steps
        here, following, later = (
            self.embed(params, episodes.obs[episode, step + ahead])
            for ahead in (0, 1, episodes.period)
        )

        # Pushed apart no farther than a margin of 1, which is the loss of states that all coincide:
        # see `episodes.UNKNOWN`.
        near = jnp.square(here - following).mean(-1)
        far = jnp.square(here - later).mean(-1)
        return near + jnp.maximum(1.0 - far, 0.0)

    def _rank(
        self, episodes: Episodes, key: Key[Array, ""]
    ) -> tuple[Int[Array, " L"], Float[Array, ""]]:
        """Returns all steps in the order of their losses, and how many of them can be used."""
        # A step needs the state a period after it, in the same episode.
        step = jnp.arange(episodes.loss.shape[1], dtype=jnp.int32)
        is_usable = step[None] + episodes.period <= episodes.length[:, None]
        # What is unusable comes last; equal losses in any order.
        ranked = jnp.where(is_usable, episodes.loss, jnp.inf).ravel()
        order = jnp.lexsort((jax.random.uniform(key, ranked.shape), ranked))
        return order.astype(jnp.int32), is_usable.sum(dtype=jnp.float32)
