"""HESS's replay of whole episodes, from which its controller and its representation learn."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

UNKNOWN = 1.0
"""Loss that a step counts as having until it is drawn, that of states which all coincide."""


class Episodes(struct.PyTreeNode):
    """A ring of E episodes of up to T steps in J periods.

    Attributes:
      obs: float32 [E, S, F], what was seen; S is T + 1.
      embedding: float32 [E, S, 2], where that lay in the subgoal space when it was stored.
      action: float32 [E, T, A].
      subgoal: float32 [E, J, 2], the controller's subgoals, in the subgoal space.
      loss: float32 [E, T], the representation's loss of each step when it was last drawn.
      length: int32 [E], steps; 0 where there is no episode yet.
      position: int32, where the next episode goes.
    """

    obs: Float[Array, "E S F"]
    embedding: Float[Array, "E S 2"]
    action: Float[Array, "E T A"]
    subgoal: Float[Array, "E J 2"]
    loss: Float[Array, "E T"]
    length: Int[Array, " E"]
    position: Int[Array, ""]

    @property
    def period(self) -> int:
        """Control steps per subgoal."""
        return self.action.shape[1] // self.subgoal.shape[1]


class Steps(struct.PyTreeNode):
    """Some stored control steps, leading axes any.

    Attributes:
      obs: float32 [F], before the step.
      embedding: float32 [2], where that lay in the subgoal space.
      subgoal: float32 [2], the controller's subgoal.
      action: float32 [A].
      next_obs: float32 [F], after the step.
      next_embedding: float32 [2].
    """

    obs: Float[Array, "*B F"]
    embedding: Float[Array, "*B 2"]
    subgoal: Float[Array, "*B 2"]
    action: Float[Array, "*B A"]
    next_obs: Float[Array, "*B F"]
    next_embedding: Float[Array, "*B 2"]


def init(capacity: int, period: int, num_periods: int, sizes: tuple[int, int]) -> Episodes:
    """Returns a ring without episodes; `sizes` are those of what is seen and of the action."""
    num_seen, num_actions = sizes
    num_steps = period * num_periods
    return Episodes(
        obs=jnp.zeros((capacity, num_steps + 1, num_seen)),
        embedding=jnp.zeros((capacity, num_steps + 1, 2)),
        action=jnp.zeros((capacity, num_steps, num_actions)),
        subgoal=jnp.zeros((capacity, num_periods, 2)),
        loss=jnp.full((capacity, num_steps), UNKNOWN, jnp.float32),
        length=jnp.zeros(capacity, jnp.int32),
        position=jnp.int32(0),
    )


def add(episodes: Episodes, batch: Episodes) -> Episodes:
    """Appends episodes, whose number divides the capacity; the oldest make room."""
    capacity, num = episodes.length.shape[0], batch.length.shape[0]
    position = (episodes.position + num) % capacity

    def put(old: Array, new: Array) -> Array:
        # Batches must divide the capacity: a slice beyond the end would be moved back, over the
        # newest episodes.
        return jax.lax.dynamic_update_slice_in_dim(old, new, episodes.position, axis=0)

    # The position has no axis of episodes.
    rings = jax.tree.map(put, episodes.replace(position=None), batch.replace(position=None))
    return rings.replace(position=position)


def sample(episodes: Episodes, shape: tuple[int, ...], key: Key[Array, ""]) -> Steps:
    """Draws control steps uniformly from what is stored."""
    # Steps are numbered through all episodes, which differ in length. A round that begins with
    # nothing stored draws as well, and needs a range that isn't empty.
    total = jnp.cumsum(episodes.length)
    rank = jax.random.randint(key, shape, 0, jnp.maximum(total[-1], 1))
    # From the right, as the sums of empty places repeat that of the place before.
    episode = jnp.searchsorted(total, rank, side="right").astype(jnp.int32)
    step = rank - (total[episode] - episodes.length[episode])

    return Steps(
        obs=episodes.obs[episode, step],
        embedding=episodes.embedding[episode, step],
        subgoal=episodes.subgoal[episode, step // episodes.period],
        action=episodes.action[episode, step],
        next_obs=episodes.obs[episode, step + 1],
        next_embedding=episodes.embedding[episode, step + 1],
    )


def period_ends(episodes: Episodes) -> tuple[Float[Array, "E J F"], Bool[Array, "E J"]]:
    """Returns what was seen at the ends of all periods, and whether there were such."""
    first = jnp.arange(episodes.subgoal.shape[1], dtype=jnp.int32) * episodes.period
    # Where an episode ends within its period the robot rests, and its last place is stored.
    obs = episodes.obs[:, episodes.period :: episodes.period]
    return obs, first[None] < episodes.length[:, None]
