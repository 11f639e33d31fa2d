"""The low level's stored steps, which can be relabelled with any direction.

Physics doesn't depend on the subgoal, so a stored step can be turned into one with another
direction (`relabel`, `restart`); `transition` then computes the reward for it.
"""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import low_obs, low_reward
from eihrl_jax.robots import robot as robot_lib


class Experience(struct.PyTreeNode):
    """One stored control step, from which the reward of any direction can be computed.

    Attributes:
      obs: before the step.
      ctrl: float32 [nu], controls in [-1, 1].
      step_xy: float32 [2], the torso's movement, units.
      outcome: whether the step ended in a fall or an unstable simulation, or with a new subgoal,
        and how upright the robot was.
      next_obs: after the step, with the new subgoal if one was given.
    """

    obs: low_obs.LowObs
    ctrl: Float[Array, " nu"]
    step_xy: Float[Array, "2"]
    outcome: low_reward.StepOutcome
    next_obs: low_obs.LowObs


def of_step(before: base.EnvState, ctrl: Float[Array, " nu"], after: base.EnvState) -> Experience:
    """Returns the step between two states of an environment, to be stored.

    `after` may be reset already: its final observation and its metrics are those of the step.
    """
    return Experience(
        obs=before.obs,
        ctrl=ctrl,
        step_xy=jnp.stack([after.metrics["step_x"], after.metrics["step_y"]]),
        outcome=low_reward.StepOutcome(
            terminated=after.terminated,
            is_switch=after.metrics["switched"] > 0,
            upright=after.metrics["upright"],
        ),
        next_obs=after.final_obs,
    )


def relabel(experience: Experience, direction: Int[Array, ""]) -> Experience:
    """Returns a stored step with another direction, at the same displacement and time left."""
    # After a switch the next subgoal's direction stays: it doesn't depend on the one before.
    next_direction = jnp.where(
        experience.outcome.is_switch, experience.next_obs.direction, direction
    ).astype(jnp.int32)
    return experience.replace(
        obs=experience.obs.replace(direction=direction),
        next_obs=experience.next_obs.replace(direction=next_direction),
    )


def restart(
    experience: Experience, direction: Int[Array, ""], robot: robot_lib.Robot
) -> Experience:
    """Returns a stored step as the first one of a new subgoal in `direction`.

    Unlike `relabel` this makes situations that occur in use: the displacement is zero, instead of
    perhaps far to the side of the new direction.
    """
    k, zero = robot.steps_per_subgoal, jnp.zeros(2)
    obs, next_obs = experience.obs, experience.next_obs
    # The first of k steps, so it isn't the one after which the subgoal changes.
    return experience.replace(
        outcome=experience.outcome.replace(is_switch=jnp.zeros((), bool)),
        obs=obs.replace(direction=direction, displacement_xy=zero, time_left=jnp.float32(1.0)),
        next_obs=next_obs.replace(
            direction=direction,
            displacement_xy=experience.step_xy,
            time_left=jnp.float32((k - 1) / k),
        ),
    )


def transition(
    experience: Experience,
    robot: robot_lib.Robot,
    input_options: low_config.LowInput,
    reward_options: low_config.LowReward,
    gamma: float,
) -> base.Transition:
    """Converts a stored step to the learner's features, action, reward and discount."""
    obs = experience.obs
    return base.Transition(
        obs=low_obs.features(obs, robot, input_options),
        action=low_obs.action_from_ctrl(experience.ctrl, obs, robot, input_options),
        # Computed here, because the environment's reward was for the original direction.
        reward=low_reward.reward(
            obs,
            experience.next_obs,
            experience.step_xy,
            experience.outcome,
            reward_options,
            robot.steps_per_subgoal,
        ),
        discount=gamma * (1.0 - experience.outcome.terminated.astype(jnp.float32)),
        next_obs=low_obs.features(experience.next_obs, robot, input_options),
    )
