"""Where robots were in evaluated episodes: the bins they visited, and where they ended."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float

from eihrl_jax import base
from eihrl_jax.envs import hierarchy

BINS_PER_CELL = 6
"""Bins along a cell's side, in which visits are counted."""


class Whereabouts(struct.PyTreeNode):
    """Where the torso of one episode has been, or of several with a leading axis.

    Attributes:
      was_there: bool [rows, columns], the bins that it came through; row 0 is the north.
      xy: float32 [2], where it is, and stays when the episode is over, units.
    """

    was_there: Bool[Array, "*n rows columns"]
    xy: Float[Array, "*n 2"]

    @classmethod
    def at_the_start(cls, num_episodes: int, num_rows: int, num_columns: int) -> "Whereabouts":
        """Returns those of episodes before their first decision."""
        return cls(
            was_there=jnp.zeros((num_episodes, num_rows, num_columns), bool),
            xy=jnp.zeros((num_episodes, 2)),
        )

    def after(self, trace: hierarchy.Trace) -> "Whereabouts":
        """Adds the path of one episode's decision, up to the episode's end."""
        num_rows, _ = self.was_there.shape
        side = base.CELL / BINS_PER_CELL
        # Rows count southwards from the maze's upper left corner, against y.
        x, y = trace.qpos[:, 0], trace.qpos[:, 1]
        i, j = jnp.floor(-y / side).astype(jnp.int32), jnp.floor(x / side).astype(jnp.int32)
        # Beyond the last row nothing is marked; a negative index would count from the end.
        i = jnp.where(trace.is_running & (i >= 0) & (j >= 0), i, num_rows)
        was_there = self.was_there.at[i, j].set(True, mode="drop")

        # The steps that count are the first ones: none of them, and all stays as it is.
        last = trace.is_running.sum() - 1
        return Whereabouts(was_there, jnp.where(last >= 0, trace.qpos[last, :2], self.xy))
