"""What robots did in each control step while they followed subgoals."""

import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int


class SubgoalStart(struct.PyTreeNode):
    """Conditions at the start of a subgoal.

    Attributes:
      is_upright: the robot had not fallen.
      is_clear: no wall was in its way; always true in corridors, which subgoals follow.
    """

    is_upright: Bool[Array, ""]
    is_clear: Bool[Array, ""]


class Steps(struct.PyTreeNode):
    """What robots did in each control step. T: steps, N: robots.

    Attributes:
      direction: int32, the subgoal that was followed.
      start: conditions at its start.
      switched: float32, 1 where it ended with this step.
      along: float32, displacement along it when it ended, units.
      lateral: float32, displacement to its left when it ended, units.
      was_down: bool, the robot lay on the ground before this step.
      fell: float32, 1 where it fell in this step.
      broke_down: float32, 1 where the simulation became unstable in this step.
      ended: bool, the episode ended with this step.
      qpos: float32, MuJoCo's positions before this step.
    """

    direction: Int[Array, "T N"]
    start: SubgoalStart
    switched: Float[Array, "T N"]
    along: Float[Array, "T N"]
    lateral: Float[Array, "T N"]
    was_down: Bool[Array, "T N"]
    fell: Float[Array, "T N"]
    broke_down: Float[Array, "T N"]
    ended: Bool[Array, "T N"]
    qpos: Float[Array, "T N nq"]


def counts(steps: Steps) -> Bool[np.ndarray, "T N"]:
    """Returns which steps end a subgoal that was begun upright with no wall in the way."""
    is_upright, is_clear = np.asarray(steps.start.is_upright), np.asarray(steps.start.is_clear)
    return (np.asarray(steps.switched) > 0) & is_upright & is_clear
