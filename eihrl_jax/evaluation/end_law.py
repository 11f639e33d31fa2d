"""A measured distribution of end points as a table: for each condition few points with weights."""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float

from eihrl_jax.envs import end_points


class Law(struct.PyTreeNode):
    """A distribution of end points: K for each of C conditions, see `end_points.CONDITIONS`.

    Attributes:
      weight: float32 [C, K], probability of each point; rows sum to 1.
      along: float32 [C, K], displacement along the subgoal from its origin, units.
      lateral: float32 [C, K], displacement to the subgoal's left, units.
      is_down: bool [C, K], whether the robot then lies on the ground.
    """

    weight: Float[Array, "C K"]
    along: Float[Array, "C K"]
    lateral: Float[Array, "C K"]
    is_down: Bool[Array, "C K"]

    @classmethod
    def of(cls, ends: end_points.EndPoints, pitch: float) -> "Law":
        """Merges the end points in each square of a grid to one at their mean.

        A condition that was never measured takes the end points of all in which the robot stands.
        If `down` was never measured, a robot on the ground is taken to stay there.

        Args:
          ends: as measured.
          pitch: side of a square of the grid, on whose lines the origin lies, units.
        """
        ends_by_condition = []
        for condition in range(len(end_points.CONDITIONS)):
            is_it = ends.condition == condition
            if not is_it.any() and condition != end_points.DOWN:
                is_it = ends.condition != end_points.DOWN
            xy = np.stack([ends.along, ends.lateral], -1)[is_it]
            is_down = ends.is_down[is_it]
            if not len(xy):
                xy, is_down = np.zeros((1, 2)), np.ones(1, bool)
            ends_by_condition.append(_grouped(xy, is_down, pitch))

        # Padded with points of weight 0 to the longest row.
        longest = max(len(rows) for rows in ends_by_condition)
        table = np.zeros((len(ends_by_condition), longest, 4), np.float32)
        for row, groups in zip(table, ends_by_condition, strict=True):
            row[: len(groups)] = groups
        weight, along, lateral, is_down = np.moveaxis(table, -1, 0)
        return cls(*map(jnp.asarray, (weight, along, lateral, is_down > 0)))


def _grouped(
    xy: Float[np.ndarray, "S 2"], is_down: Bool[np.ndarray, " S"], pitch: float
) -> Float[np.ndarray, "K 4"]:
    """Returns weight, mean x and y, and whether the robot is down, for squares with end points."""
    keys = np.column_stack([np.floor(xy / pitch), is_down])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    counts = np.bincount(group)
    means = [np.bincount(group, axis) / counts for axis in (*xy.T, is_down)]
    return np.column_stack([counts / len(xy), *means])
