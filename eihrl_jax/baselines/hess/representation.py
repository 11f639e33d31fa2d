"""HESS's representation: slow features of what is seen, kept stable where they already fit.

Li et al. 2021, Active hierarchical exploration with stable subgoal representation learning, Sec.
3.1: neighbours in time are drawn together, states a period apart pushed apart, and states whose
loss is low are anchored to where they were.
"""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax.agents import optimisation
from eihrl_jax.config import hess as config_lib
from eihrl_jax.networks import mlp

NUM_SUBGOAL = 2
"""Size of the subgoal space."""

UNKNOWN = 1.0
"""Loss that a step counts as having until it is drawn, that of states which all coincide."""


class RepresentationState(struct.PyTreeNode):
    """What the representation is learned with. E episodes of T steps.

    Attributes:
      params: of the network.
      opt_state: of Adam.
      loss: float32 [E, T], contrastive loss of each stored step when it was last drawn.
      num_blocks: int32, blocks of training so far.
      is_frozen: whether subgoals are reached so well that training has stopped.
    """

    params: Any
    opt_state: optax.OptState
    loss: Float[Array, "E T"]
    num_blocks: Int[Array, ""]
    is_frozen: Bool[Array, ""]


class Stored(NamedTuple):
    """Stored episodes as the representation sees them.

    Attributes:
      obs: float32 [E, S, F], what was seen; S is T + 1.
      length: int32 [E], steps of each episode, 0 where there is none yet.
    """

    obs: Float[Array, "E S F"]
    length: Int[Array, " E"]


class Representation:
    """The functions of the network; holds no state."""

    def __init__(self, num_seen: int, period: int, options: config_lib.Representation):
        """Builds network and optimiser.

        Args:
          num_seen: size F of what is seen.
          period: control steps after which states are pushed apart.
          options: sizes and numbers.
        """
        self.options = options
        self._num_seen = num_seen
        self._period = period
        self._network = mlp.Mlp(options.hidden, NUM_SUBGOAL)
        self._optimizer = optax.adam(options.learning_rate)

    def init(self, shape: tuple[int, int], key: Key[Array, ""]) -> RepresentationState:
        """Draws the parameters; `shape` is that of the memory, episodes and steps."""
        params = self._network.init(key, jnp.zeros(self._num_seen))["params"]
        return RepresentationState(
            params=params,
            opt_state=self._optimizer.init(params),
            loss=jnp.full(shape, UNKNOWN, jnp.float32),
            num_blocks=jnp.int32(0),
            is_frozen=jnp.zeros((), bool),
        )

    def place(self, params: Any, obs: Float[Array, "*B F"]) -> Float[Array, "*B 2"]:
        """Returns phi, where states lie in the subgoal space."""
        return cast(Array, self._network.apply({"params": params}, obs))

    def train(
        self,
        state: RepresentationState,
        stored: Stored,
        stability: Float[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[RepresentationState, Float[Array, ""]]:
        """Trains a block of updates, anchored to the network of before it.

        Args:
          state: where the representation is.
          stored: episodes.
          stability: weight of the anchors, lambda.
          key: consumed.

        Returns:
          The new state, and the mean loss.
        """
        anchor_params, losses = state.params, state.loss
        weight = jnp.where(state.num_blocks > 0, stability, 0.0)
        tie_key, key = jax.random.split(key)
        worst, anchored = self._split(stored, losses, tie_key)

        def body(
            carry: tuple[Any, Any, Float[Array, "E T"]], key: Key[Array, ""]
        ) -> tuple[tuple[Any, Any, Float[Array, "E T"]], Float[Array, ""]]:
            params, opt_state, losses = carry
            pair_key, anchor_key = jax.random.split(key)
            pair = _draw(worst, self.options.batch_size, pair_key)
            calm = stored.obs[_draw(anchored, self.options.batch_size, anchor_key)]
            calm_place = self.place(anchor_params, calm)
            (loss, own), grads = jax.value_and_grad(self._loss, has_aux=True)(
                params, stored, pair, calm, calm_place, weight
            )
            params, opt_state = optimisation.step(self._optimizer, grads, opt_state, params)
            return (params, opt_state, losses.at[pair].set(own)), loss

        start = state.params, state.opt_state, losses
        keys = jax.random.split(key, self.options.num_updates)
        (params, opt_state, losses), totals = jax.lax.scan(body, start, keys)
        state = state.replace(
            params=params, opt_state=opt_state, loss=losses, num_blocks=state.num_blocks + 1
        )
        return state, totals.mean()

    def _loss(
        self,
        params: Any,
        stored: Stored,
        pair: tuple[Int[Array, " B"], Int[Array, " B"]],
        calm: Float[Array, "B F"],
        calm_place: Float[Array, "B 2"],
        stability: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Float[Array, " B"]]:
        """Returns the whole loss, and the contrastive one of each of the steps `pair`."""
        own = self._contrast(params, stored, *pair)
        moved = self.place(params, calm) - calm_place
        return own.mean() + stability * jnp.square(moved).mean(), own

    def _contrast(
        self, params: Any, stored: Stored, episode: Int[Array, " B"], step: Int[Array, " B"]
    ) -> Float[Array, " B"]:
        """Returns the contrastive loss of stored steps."""
        here, following, later = (
            self.place(params, stored.obs[episode, step + ahead]) for ahead in (0, 1, self._period)
        )
        near = jnp.square(here - following).mean(-1)
        far = jnp.square(here - later).mean(-1)
        return near + jnp.maximum(1.0 - far, 0.0)

    def _split(
        self, stored: Stored, losses: Float[Array, "E T"], key: Key[Array, ""]
    ) -> tuple["_Part", "_Part"]:
        """Returns the worse half of the stored steps, and those that are anchored."""
        step = jnp.arange(losses.shape[1], dtype=jnp.int32)
        is_usable = step[None] + self._period <= stored.length[:, None]
        # What is unusable comes last; equal losses in any order.
        ranked = jnp.where(is_usable, losses, jnp.inf).ravel()
        tie = jax.random.uniform(key, ranked.shape)
        order = jnp.lexsort((tie, ranked)).astype(jnp.int32)
        num = is_usable.sum(dtype=jnp.float32)
        calm = self.options.anchored_share * num
        anchored = (jnp.float32(0.0), calm)
        if self.options.anchors == "rest":
            anchored = (calm, num)
        columns = losses.shape[1]
        return _Part(order, columns, 0.5 * num, num), _Part(order, columns, *anchored)


class _Part(NamedTuple):
    """Stored steps from one rank to another, by their loss."""

    order: Int[Array, " L"]
    columns: int
    first: Float[Array, ""]
    end: Float[Array, ""]


def _draw(part: _Part, num: int, key: Key[Array, ""]) -> tuple[Int[Array, " B"], Int[Array, " B"]]:
    """Draws episodes and steps uniformly from a part."""
    share = jax.random.uniform(key, (num,))
    rank = part.first + share * (part.end - part.first)
    flat = part.order[rank.astype(jnp.int32)]
    return flat // part.columns, flat % part.columns
