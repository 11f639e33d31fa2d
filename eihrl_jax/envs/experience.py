"""Steps of the low level as they are stored, to be learned from under any direction.

Physics doesn't depend on the subgoal, so a stored step can be looked at again as if another
direction had been asked for (`relabel`, `restart`); `transition` then pays it accordingly.
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
      outcome: how the step ended: in a fall or a breakdown, with a new subgoal, how upright.
      next_obs: after the step, and already of a subgoal that was given after it.
    """

    obs: low_obs.LowObs
    ctrl: Float[Array, " nu"]
    step_xy: Float[Array, "2"]
    outcome: low_reward.StepOutcome
    next_obs: low_obs.LowObs


def of_step(before: base.EnvState, ctrl: Float[Array, " nu"], after: base.EnvState) -> Experience:
    """Returns what is to be stored of a step, from the environment before and after it.

    `after` may already be reset: its final observation and its metrics are still of the step.
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
    """Returns a stored step as if `direction` had been asked for; physics doesn't depend on it."""
    # After a switch the robot follows another subgoal, whatever the one before was.
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
    """Returns a stored step as if `direction` had been asked for just before it.

    Unlike those of `relabel`, such steps are what the robot meets: nobody has come far sideways.
    """
    k, zero = robot.steps_per_subgoal, jnp.zeros(2)
    obs, next_obs = experience.obs, experience.next_obs
    # As the first of the subgoal's k steps, so it can't be the one after which subgoals change.
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
    """Returns a stored step as the learner sees it: features, action, reward, discount."""
    obs = experience.obs
    return base.Transition(
        obs=low_obs.features(obs, robot, input_options),
        action=low_obs.action_from_ctrl(experience.ctrl, obs, robot, input_options),
        # Computed anew: the environment paid for the direction that it had asked for.
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
