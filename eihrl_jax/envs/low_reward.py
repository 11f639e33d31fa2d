"""The low level's reward for steps towards the subgoal (paper, Sec. 2, eq. 1)."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import low_obs
from eihrl_jax.ops import rotations


class StepOutcome(struct.PyTreeNode):
    """How a control step ended, as far as the reward depends on it.

    Attributes:
      terminated: the robot fell or the simulation became unstable.
      is_switch: a new subgoal was given.
      upright: how upright the robot is, see `recovery.uprightness`.
    """

    terminated: Bool[Array, ""]
    is_switch: Bool[Array, ""]
    upright: Float[Array, ""]


def reward(
    obs: low_obs.LowObs,
    next_obs: low_obs.LowObs,
    step_xy: Float[Array, "2"],
    outcome: StepOutcome,
    options: low_config.LowReward,
    steps_per_subgoal: int,
) -> Float[Array, ""]:
    """Computes the reward of one control step, for following the subgoal and for standing.

    An anchored subgoal may begin away from its origin. The potential of that displacement is added
    when the subgoal is given, because the way back to the line is rewarded: otherwise a robot would
    gain by going too far and coming back.

    Args:
      obs: before the step, with the subgoal that was to be followed.
      next_obs: after it, with the next subgoal if one was given.
      step_xy: float32 [2], the step's movement, units.
      outcome: how it ended.
      options: weights of the terms.
      steps_per_subgoal: control steps per subgoal.
    """
    following = step_reward(obs, step_xy, outcome.terminated, options, steps_per_subgoal)
    offset = options.scale * _potential(
        next_obs.displacement_xy, next_obs.time_left, next_obs.direction, options
    )
    is_given = outcome.is_switch & ~outcome.terminated
    return following + jnp.where(is_given, offset, 0.0) + options.standing * outcome.upright


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
      terminated: the robot fell or the simulation became unstable.
      options: scale, weights of drift and falls, and the reward beyond one cell.
      steps_per_subgoal: control steps per subgoal.

    Source: paper, eq. 1.
    Differs from the paper: drift, stop and falls are options, off in preset `paper`.
    """
    # A difference of potentials: going back takes away the reward of going there.
    left = obs.time_left - 1.0 / steps_per_subgoal
    after = _potential(obs.displacement_xy + step_xy, left, obs.direction, options)
    gain = after - _potential(obs.displacement_xy, obs.time_left, obs.direction, options)
    return options.scale * gain - options.fall_cost * terminated.astype(jnp.float32)


def _potential(
    xy: Float[Array, "2"],
    left: Float[Array, ""],
    direction: Int[Array, ""],
    options: low_config.LowReward,
) -> Float[Array, ""]:
    """Returns the potential of a displacement with a share `left` of the subgoal's time left."""
    # In the frame of the subgoal, along is g . d of eq. 1.
    along, lateral = rotations.to_direction_frame(xy, direction)
    # Progress counts fully up to this distance, units.
    enough = base.CELL * (1.0 - left) if options.is_paced else base.CELL
    beyond = jnp.maximum(along - enough, 0.0)
    along += (options.beyond_cell - 1.0) * beyond
    return along - options.lateral_weight * jnp.abs(lateral)
