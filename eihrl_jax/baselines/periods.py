"""Periods of two levels: an upper one names a subgoal every k steps, a lower one acts in between.

All robots begin their periods together. One whose episode ends within a period rests until it is
over; `World.renew` then begins a new episode.
"""

from collections.abc import Callable
from typing import Generic, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.baselines.world import World

SubgoalT = TypeVar("SubgoalT")

Choose: TypeAlias = Callable[[base.GoalObs, Key[Array, ""]], SubgoalT]
"""The upper level: from what is seen and a key to a subgoal."""

Act: TypeAlias = Callable[[base.GoalObs, SubgoalT, Key[Array, ""]], Float[Array, " nu"]]
"""The lower level: from what is seen, the subgoal as it is now, and a key to an action."""

Move: TypeAlias = Callable[[SubgoalT, Float[Array, "2"], Float[Array, "2"]], SubgoalT]
"""What a subgoal becomes after a step, given the torso's x and y before and after it, units."""


class Period(struct.PyTreeNode, Generic[SubgoalT]):
    """One period; leading axes [k, N], k steps of N robots.

    Attributes:
      obs: before each step.
      subgoal: as it was then, a pytree of the upper level's own.
      action: float32 [k, N, nu], what the lower level did.
      reward: float32 [k, N], of the task.
      is_running: bool [k, N], whether the episode went on through the step; else it doesn't count.
      terminated: bool [k, N], whether the episode ended for good with it.
      truncated: bool [k, N], whether its time was up after it.
      next_obs: after each step.
      metrics: what the environment measures, after each step.
    """

    obs: base.GoalObs
    subgoal: SubgoalT
    action: Float[Array, "k N nu"]
    reward: Float[Array, "k N"]
    is_running: Bool[Array, "k N"]
    terminated: Bool[Array, "k N"]
    truncated: Bool[Array, "k N"]
    next_obs: base.GoalObs
    metrics: dict[str, Float[Array, "k N"]]


class Carry(struct.PyTreeNode):
    """What a policy of two levels remembers from one control step to the next.

    Attributes:
      subgoal: float32 [2], as it was at the last step.
      xy: float32 [2], where the torso was then, units.
      steps_left: int32, control steps left in the period; 0: the next subgoal is due.
    """

    subgoal: Float[Array, "2"]
    xy: Float[Array, "2"]
    steps_left: Int[Array, ""]

    @classmethod
    def start(cls) -> "Carry":
        """Returns the carry at the beginning of an episode."""
        # A subgoal is due at the first step, so that these zeros are never used.
        return cls(subgoal=jnp.zeros(2), xy=jnp.zeros(2), steps_left=jnp.int32(0))

    def advance(
        self,
        chosen: Float[Array, "2"],
        xy: Float[Array, "2"],
        num_steps: int,
        move: Move[Float[Array, "2"]],
    ) -> "Carry":
        """Returns the carry with the subgoal of this step.

        Args:
          chosen: the subgoal that the upper level would choose now.
          xy: where the torso is, units.
          num_steps: k.
          move: what becomes of a subgoal.
        """
        is_due = self.steps_left == 0
        return Carry(
            subgoal=jnp.where(is_due, chosen, move(self.subgoal, self.xy, xy)),
            xy=xy,
            steps_left=jnp.where(is_due, jnp.int32(num_steps), self.steps_left) - 1,
        )


def run(
    world: World,
    envs: base.EnvState,
    num_steps: int,
    choose: Choose[SubgoalT],
    act: Act[SubgoalT],
    move: Move[SubgoalT],
    key: Key[Array, ""],
    *,
    reach: float = 1.0,
) -> tuple[base.EnvState, Period[SubgoalT]]:
    """Runs one period.

    Args:
      world: where; its `step` rests where the episode is over.
      envs: states with leading axis N.
      num_steps: k.
      choose: the upper level.
      act: the lower level.
      move: what becomes of a subgoal.
      key: consumed.
      reach: the action that stands for a control of 1.

    Returns:
      The states after it, and what happened.
    """
    num_envs = envs.reward.shape[0]
    choose_key, act_key = jax.random.split(key)
    subgoal = jax.vmap(choose)(envs.obs, jax.random.split(choose_key, num_envs))

    def body(
        carry: tuple[base.EnvState, SubgoalT], step_key: Key[Array, ""]
    ) -> tuple[tuple[base.EnvState, SubgoalT], Period[SubgoalT]]:
        envs, subgoal = carry
        action = jax.vmap(act)(envs.obs, subgoal, jax.random.split(step_key, num_envs))
        stepped = world.step(envs, action / reach)

        period = Period(
            obs=envs.obs,
            subgoal=subgoal,
            action=action,
            reward=stepped.reward,
            # Told by the flags before the step: the one that ends an episode still counts.
            is_running=~envs.is_over,
            terminated=stepped.terminated,
            truncated=stepped.truncated,
            next_obs=stepped.final_obs,
            metrics=stepped.metrics,
        )

        subgoal = jax.vmap(move)(subgoal, envs.obs.xy, stepped.final_obs.xy)
        return (stepped, subgoal), period

    (envs, _), period = jax.lax.scan(body, (envs, subgoal), jax.random.split(act_key, num_steps))
    return envs, period


def has_arrived(period: Period, reward: base.Reward) -> Bool[Array, "*P k N"]:
    """Returns whether the upper level's goal has been reached in the period, up to each step.

    To a level that is told its goal, with sparse reward, reaching it is an end with the value of an
    end, as in mazes with one goal: what follows has another goal. Dense reward goes on.

    Args:
      period: what happened; leading axes [*P, k, N].
      reward: of the task.
    """
    if reward == "dense":
        return jnp.zeros(period.is_running.shape, bool)
    # Where a goal is reached another one follows, or the robot's own place; without pay it is
    # another place of the same goal that has become the nearest.
    has_changed = (period.next_obs.goal_xy != period.obs.goal_xy).any(-1)
    is_new_goal = has_changed & (period.reward > 0.0) & period.is_running
    return jnp.cumsum(is_new_goal, axis=-2) > 0


def is_task_over(period: Period, reward: base.Reward) -> Bool[Array, "*P N"]:
    """Returns in which periods the upper level's task has ended: see `has_arrived`.

    A simulation that breaks down is no end without a value: where time costs, nothing costs less.
    """
    # A robot at rest keeps flags and metrics, so that the last step tells of the whole period.
    is_broken = period.metrics["broke_down"][..., -1, :] > 0.0
    is_over = period.terminated[..., -1, :] & ~is_broken
    return is_over | has_arrived(period, reward)[..., -1, :]


def paid(period: Period, costs_time: bool, reward: base.Reward) -> Float[Array, "*P k N"]:
    """Returns the task's rewards of steps that count, 0 of others: see `has_arrived`.

    Args:
      period: what happened; leading axes [*P, k, N].
      costs_time: whether each step costs 1, which makes rewards of 1 and 0 those of 0 and -1.
      reward: of the task.
    """
    arrived = has_arrived(period, reward)
    # The step that arrives is still paid; those after it are on the way to another goal.
    was_there = jnp.concatenate([jnp.zeros_like(arrived[..., :1, :]), arrived[..., :-1, :]], -2)
    rewards = period.reward - (1.0 if costs_time else 0.0)
    return jnp.where(period.is_running & ~was_there, rewards, 0.0)


def is_end(period: Period) -> Bool[Array, "*P k N"]:
    """Returns which steps ended an episode."""
    return period.is_running & (period.terminated | period.truncated)


def is_due(num_steps: Int[Array, ""], steps_per_round: int, every: int) -> Bool[Array, ""]:
    """Returns whether the last round, if any, went past a multiple of `every` control steps."""
    # Before the first round the difference is negative: 0 would count as gone past.
    before = jnp.maximum(num_steps - steps_per_round, 0)
    return num_steps // every > before // every


def sum_ends(
    is_end: Bool[Array, "*N"], metrics: dict[str, Float[Array, "*N"]]
) -> dict[str, Float[Array, ""]]:
    """Returns sums of metrics over the ends of episodes, as `sum_<name>`, and their number."""
    sums = {f"sum_{name}": jnp.where(is_end, each, 0.0).sum() for name, each in metrics.items()}
    return sums | {"episodes": is_end.sum(dtype=jnp.float32)}
