"""What the low level is paid for: every step towards the subgoal (paper, Sec. 2, eq. 1)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.ops import rotations


def step_reward(
    displacement_xy: Float[Array, "2"],
    step_xy: Float[Array, "2"],
    time_left: Float[Array, ""],
    direction: Int[Array, ""],
    terminated: Bool[Array, ""],
    options: low_config.LowReward,
    steps_per_subgoal: int,
) -> Float[Array, ""]:
    """Computes the intrinsic reward of one control step.

    With default options it is eq. 1, alpha * cos<g, d> * |d| = alpha * (g . d) for a step d, in the
    form that has no singularity at d = 0.

    Args:
      displacement_xy: float32 [2], movement since the subgoal was given, before the step, units.
      step_xy: float32 [2], the step's movement, units.
      time_left: float32, fraction of the subgoal's steps that was left before the step.
      direction: int32, the subgoal that was to be followed.
      terminated: the step ended in a fall or a breakdown.
      options: scale, prices of drift and falls, and whether a full cell is enough.
      steps_per_subgoal: control steps per subgoal.

    Source: paper, eq. 1.
    Differs from the paper: drift, stop and falls are options, off in preset `paper`.
    """

    def potential(xy: Float[Array, "2"], left: Float[Array, ""]) -> Float[Array, ""]:
        along, lateral = rotations.to_direction_frame(xy, direction)
        enough = base.CELL * (1.0 - left) if options.is_paced else base.CELL
        beyond = jnp.maximum(along - enough, 0.0)
        along += (options.beyond_cell - 1.0) * beyond
        return along - options.lateral_weight * jnp.abs(lateral)

    after = potential(displacement_xy + step_xy, time_left - 1.0 / steps_per_subgoal)
    gain = after - potential(displacement_xy, time_left)
    return options.scale * gain - options.fall_cost * terminated.astype(jnp.float32)
