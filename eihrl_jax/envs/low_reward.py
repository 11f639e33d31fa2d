"""What the low level is paid for: every step towards the subgoal (paper, Sec. 2, eq. 1)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import low_obs
from eihrl_jax.ops import rotations


def step_reward(
    obs: low_obs.LowObs,
    step_xy: Float[Array, "2"],
    terminated: Bool[Array, ""],
    options: low_config.LowReward,
    steps_per_subgoal: int,
) -> Float[Array, ""]:
    """Computes the intrinsic reward of one control step.

    With default options it is eq. 1, alpha * cos<g, d> * |d| = alpha * (g . d) for a step d, in the
    form that has no singularity at d = 0.

    Args:
      obs: before the step, with the subgoal that was to be followed.
      step_xy: float32 [2], the step's movement, units.
      terminated: the step ended in a fall or a breakdown.
      options: scale, prices of drift and falls, and whether a full cell is enough.
      steps_per_subgoal: control steps per subgoal.

    Source: paper, eq. 1.
    Differs from the paper: drift, stop and falls are options, off in preset `paper`.
    """

    def potential(xy: Float[Array, "2"], left: Float[Array, ""]) -> Float[Array, ""]:
        # In the frame of the subgoal, along is g . d of eq. 1.
        along, lateral = rotations.to_direction_frame(xy, obs.direction)
        # Progress counts in full up to here.
        enough = base.CELL * (1.0 - left) if options.is_paced else base.CELL
        beyond = jnp.maximum(along - enough, 0.0)
        along += (options.beyond_cell - 1.0) * beyond
        return along - options.lateral_weight * jnp.abs(lateral)

    # A difference of potentials: going back takes away what going there has paid.
    after = potential(obs.displacement_xy + step_xy, obs.time_left - 1.0 / steps_per_subgoal)
    gain = after - potential(obs.displacement_xy, obs.time_left)
    return options.scale * gain - options.fall_cost * terminated.astype(jnp.float32)
