"""A batch of episodes, which moves to a smaller compiled program when few of them are left.

A batch's program takes the same time for an episode that is over as for one that runs, and in large
mazes the last episode takes many times as long as most.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Key

from eihrl_jax import base
from eihrl_jax.evaluation import whereabouts as whereabouts_lib

SHARE = 8
"""Each smaller program has this many times fewer episodes than the one before."""

MIN_DECISIONS = 500
"""A smaller program isn't worth compiling where at most fewer decisions than this are left."""


class Lanes(NamedTuple):
    """Some episodes of a batch. L: lanes, one episode each; some episodes may be over.

    Attributes:
      state: of the environments, leaves [L, ...].
      places: where the torsos are, and have been.
      keys: of the episodes' high levels.
      recorded: lanes of the episodes that are recorded; lane 0 for one that was left behind.
      rows: which episode of the batch each lane is.
    """

    state: base.EnvState
    places: whereabouts_lib.Whereabouts
    keys: Key[Array, " L"]
    recorded: Int[Array, " R"]
    rows: Int[np.ndarray, " L"]

    @property
    def is_running(self) -> Bool[np.ndarray, " L"]:
        """Which episodes aren't over."""
        return ~np.asarray(self.state.is_over)

    def is_thin(self, num_left: int) -> bool:
        """Returns whether the running episodes fit into a smaller program that is worth compiling.

        Args:
          num_left: most decisions that one of them has left.
        """
        if num_left < MIN_DECISIONS:
            return False  # as in most mazes: no transfer from the device
        return 0 < int(self.is_running.sum()) <= len(self.rows) // SHARE

    def thinned(self) -> "Lanes":
        """Returns the running episodes, filled up with others to the size of the next program."""
        # The number of running episodes alone decides: results don't depend on the machine.
        order = np.argsort(~self.is_running, kind="stable")
        chosen = np.sort(order[: len(self.rows) // SHARE])
        where = {int(lane): i for i, lane in enumerate(chosen)}
        recorded = [where.get(int(lane), 0) for lane in self.recorded]
        state, places, keys = jax.tree.map(
            lambda leaf: leaf[chosen], (self.state, self.places, self.keys)
        )
        return Lanes(state, places, keys, jnp.asarray(recorded, jnp.int32), self.rows[chosen])

    def put_back(self, part: "Lanes") -> "Lanes":
        """Returns these lanes with the states and places of those that are also in `part`."""
        if len(part.rows) == len(self.rows):
            return part
        state, places = jax.tree.map(
            lambda leaf, new: leaf.at[part.rows].set(new),
            (self.state, self.places),
            (part.state, part.places),
        )
        return self._replace(state=state, places=places)
