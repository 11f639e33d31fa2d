"""HIRO's off-policy correction: an old subgoal becomes one that the controller of today would need.

Nachum et al. 2018, Data-efficient hierarchical reinforcement learning, Sec. 3.3.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Key

SPREAD = 0.5
"""Standard deviation of drawn subgoals as a share of the manager's reach."""


class SubgoalRow(struct.PyTreeNode):
    """A stored subgoal. k: control steps, F: size of what is seen, A: of the action.

    Attributes:
      obs: float32 [k, F], before each step.
      action: float32 [k, A], what the controller did.
      is_running: bool [k], whether the step counts.
      subgoal: float32 [2], the displacement that was asked for, units.
      goal_xy: float32 [2], the task's goal then, units.
      reward: float32, of the task.
      next_obs: float32 [F], after the last step.
      next_goal_xy: float32 [2], the task's goal after it.
      terminated: whether the episode ended for good, or the goal was reached.
      truncated: whether its time was up.
    """

    obs: Float[Array, "k F"]
    action: Float[Array, "k A"]
    is_running: Bool[Array, " k"]
    subgoal: Float[Array, "2"]
    goal_xy: Float[Array, "2"]
    reward: Float[Array, ""]
    next_obs: Float[Array, " F"]
    next_goal_xy: Float[Array, "2"]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]


def correct(
    row: SubgoalRow,
    act: Callable[[Float[Array, "C k F"], Float[Array, "C k 2"]], Float[Array, "C k A"]],
    reach: float,
    num_candidates: int,
    key: Key[Array, ""],
) -> Float[Array, "2"]:
    """Returns the subgoal, of some candidates, that best explains what the controller did.

    Args:
      row: what is stored; the first two entries of what is seen are the torso's x and y.
      act: the controller of today, from what is seen and the displacement left.
      reach: greatest size of a subgoal's entries, units.
      num_candidates: the stored subgoal, the displacement achieved, and draws around the latter.
      key: consumed.

    Returns:
      The candidate of the greatest likelihood, -1/2 sum |pi(s_i, g_i) - a_i|^2.

    Source: HIRO, eq. 5.
    """
    if num_candidates == 1:
        return row.subgoal

    # HIRO, Sec. 3.3: what was asked for, what came of it, and draws around the latter.
    start_xy = row.obs[0, :2]
    achieved = row.next_obs[:2] - start_xy
    noise = SPREAD * reach * jax.random.normal(key, (num_candidates - 2, 2))
    drawn = jnp.clip(achieved[None] + noise, -reach, reach)
    candidates = jnp.concatenate([row.subgoal[None], achieved[None], drawn])

    # Each candidate names a place, to which less is left as the robot goes there.
    left = candidates[:, None] + (start_xy[None] - row.obs[:, :2])[None]
    seen = jnp.broadcast_to(row.obs[None], (num_candidates, *row.obs.shape))

    # HIRO, eq. 5: the candidate of the greatest likelihood has the least squared error.
    error = jnp.square(act(seen, left) - row.action[None]).sum(-1)
    # What was done at rest led nowhere, and explains nothing.
    error = jnp.where(row.is_running[None], error, 0.0).sum(-1)
    return candidates[jnp.argmin(error)]
