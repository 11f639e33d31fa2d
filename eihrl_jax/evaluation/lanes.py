"""Episodes that run side by side; where few of many are left, they go on in a smaller program.

The program of a batch costs as much for an episode that is over as for one that runs, and in large
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
"""The programs of a batch have this many times fewer episodes from one to the next."""

MIN_DECISIONS = 500
"""Decisions that must be left at most for a smaller program: it has to be compiled first."""


class Lanes(NamedTuple):
    """Some episodes of a batch of E. L: lanes, some of which may be over.

    Attributes:
      state: of the environments, leaves [L, ...].
      places: where the torsos are, and have been.
      keys: of the high level's draws.
      recorded: lanes of the episodes that are recorded; any lane where such an episode is over.
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
        """Returns whether the running episodes fit into a smaller program that pays.

        Args:
          num_left: most decisions that one of them has left.
        """
        if num_left < MIN_DECISIONS:
            return False  # without a look at the device, as in most mazes
        return 0 < int(self.is_running.sum()) <= len(self.rows) // SHARE

    def thinned(self) -> "Lanes":
        """Returns the running episodes, filled up with others to the size of the next program."""
        # By numbers alone, so that the same episodes always run in the same programs.
        order = np.argsort(~self.is_running, kind="stable")
        chosen = np.sort(order[: len(self.rows) // SHARE])
        where = {int(lane): i for i, lane in enumerate(chosen)}
        recorded = [where.get(int(lane), 0) for lane in self.recorded]
        state, places, keys = jax.tree.map(
            lambda leaf: leaf[chosen], (self.state, self.places, self.keys)
        )
        return Lanes(state, places, keys, jnp.asarray(recorded, jnp.int32), self.rows[chosen])

    def put_back(self, part: "Lanes") -> "Lanes":
        """Returns these lanes, with what has become of some or all of them since."""
        if len(part.rows) == len(self.rows):
            return part
        state, places = jax.tree.map(
            lambda leaf, new: leaf.at[part.rows].set(new),
            (self.state, self.places),
            (part.state, part.places),
        )
        return self._replace(state=state, places=places)
