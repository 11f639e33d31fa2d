"""HESS's memory of whole episodes, from which its controller and its representation learn."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax.baselines.hess import representation


class Episodes(struct.PyTreeNode):
    """A ring of E episodes of up to T steps in J periods.

    Attributes:
      obs: float32 [E, S, F], what was seen; S is T + 1.
      place: float32 [E, S, 2], where that lay in the subgoal space when it was stored.
      action: float32 [E, T, A].
      subgoal: float32 [E, J, 2], where the controller was told to go, in the subgoal space.
      length: int32 [E], steps; 0 where there is no episode yet.
      position: int32, where the next episode goes.
    """

    obs: Float[Array, "E S F"]
    place: Float[Array, "E S 2"]
    action: Float[Array, "E T A"]
    subgoal: Float[Array, "E J 2"]
    length: Int[Array, " E"]
    position: Int[Array, ""]

    @property
    def stored(self) -> representation.Stored:
        """What the representation learns from."""
        return representation.Stored(self.obs, self.length)


class Steps(struct.PyTreeNode):
    """Some stored control steps, leading axes any.

    Attributes:
      obs: float32 [F], before the step.
      place: float32 [2], where that lay in the subgoal space.
      subgoal: float32 [2], where the controller was told to go.
      action: float32 [A].
      next_obs: float32 [F], after the step.
      next_place: float32 [2].
    """

    obs: Float[Array, "*B F"]
    place: Float[Array, "*B 2"]
    subgoal: Float[Array, "*B 2"]
    action: Float[Array, "*B A"]
    next_obs: Float[Array, "*B F"]
    next_place: Float[Array, "*B 2"]


def init(capacity: int, period: int, num_periods: int, sizes: tuple[int, int]) -> Episodes:
    """Returns an empty memory; `sizes` are those of what is seen and of the action."""
    num_seen, num_actions = sizes
    num_steps = period * num_periods
    return Episodes(
        obs=jnp.zeros((capacity, num_steps + 1, num_seen)),
        place=jnp.zeros((capacity, num_steps + 1, 2)),
        action=jnp.zeros((capacity, num_steps, num_actions)),
        subgoal=jnp.zeros((capacity, num_periods, 2)),
        length=jnp.zeros(capacity, jnp.int32),
        position=jnp.int32(0),
    )


def add(memory: Episodes, batch: Episodes) -> Episodes:
    """Appends episodes, whose number divides the capacity; the oldest make room."""
    capacity, num = memory.length.shape[0], batch.length.shape[0]

    def put(old: Array, new: Array) -> Array:
        return jax.lax.dynamic_update_slice_in_dim(old, new, memory.position, axis=0)

    position = (memory.position + num) % capacity
    everything = jax.tree.map(put, _arrays(memory), _arrays(batch))
    return memory.replace(**everything, position=position)


def sample(memory: Episodes, shape: tuple[int, ...], key: Key[Array, ""]) -> Steps:
    """Draws control steps uniformly from what is stored."""
    total = jnp.cumsum(memory.length)
    rank = jax.random.randint(key, shape, 0, jnp.maximum(total[-1], 1))
    episode = jnp.searchsorted(total, rank, side="right").astype(jnp.int32)
    step = rank - (total[episode] - memory.length[episode])
    period = memory.action.shape[1] // memory.subgoal.shape[1]
    return Steps(
        obs=memory.obs[episode, step],
        place=memory.place[episode, step],
        subgoal=memory.subgoal[episode, step // period],
        action=memory.action[episode, step],
        next_obs=memory.obs[episode, step + 1],
        next_place=memory.place[episode, step + 1],
    )


def period_ends(memory: Episodes) -> tuple[Float[Array, "E J F"], Bool[Array, "E J"]]:
    """Returns what was seen at the ends of all periods, and whether there were such."""
    num_periods = memory.subgoal.shape[1]
    period = memory.action.shape[1] // num_periods
    first = jnp.arange(num_periods, dtype=jnp.int32) * period
    return memory.obs[:, period::period], first[None] < memory.length[:, None]


def _arrays(memory: Episodes) -> dict[str, Array]:
    names = ("obs", "place", "action", "subgoal", "length")
    return {name: getattr(memory, name) for name in names}
