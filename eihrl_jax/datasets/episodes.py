"""Runs episodes and returns everything that a dataset records of them."""

import dataclasses
from typing import Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Int, Key, PyTree

from eihrl_jax import base
from eihrl_jax.envs import goal_maze, hierarchy, oracle_maze, physics_maze, task
from eihrl_jax.evaluation import loading
from eihrl_jax.gym.high_level import HighLevelTask
from eihrl_jax.gym.maze import MazeTask
from eihrl_jax.ops import tree
from eihrl_jax.reporting import facade

EnvState: TypeAlias = base.EnvState[Any, Any]
"""State of `OracleMaze`, or of `PhysicsMaze`."""

Infos: TypeAlias = dict[str, Array]


class Shown(NamedTuple):
    """What a dataset records of the state at one moment.

    Attributes:
      obs: the Gymnasium environment's observation.
      infos: further arrays by name.
    """

    obs: PyTree[Array]
    infos: Infos


class Steps(struct.PyTreeNode):
    """The k steps of the dataset that one decision makes.

    Attributes:
      shown: the state after each step.
      action: the action of each step.
      direction: int32, the subgoal that was followed.
      outcome: of each step.
      is_running: whether the episode wasn't over before the step; steps after the end don't count.
    """

    shown: Shown
    action: Array
    direction: Int[Array, " k"]
    outcome: base.Outcome
    is_running: Bool[Array, " k"]


@runtime_checkable
class Recorder(Protocol):
    """Runs episodes of a hierarchy and records them."""

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins the episode of the Gymnasium environment with that seed's key."""
        ...

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and follows it; the state of an episode that is over stays as it is."""
        ...


@dataclasses.dataclass(frozen=True)
class Walking:
    """A robot with physics, recorded control step by control step.

    Attributes:
      high: chooses directions.
      levels: the robot in the maze, with its low level.
      maze: the same maze as in `eihrl_jax/Maze-v0`.
      gym_task: gives that environment's observations and rewards.
    """

    high: loading.HighLevel
    levels: hierarchy.Hierarchy
    maze: goal_maze.GoalMaze
    gym_task: MazeTask

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins an episode, see `Recorder`."""
        state = self.levels.reset(key, jnp.int32(0))
        return state, self._show(state.inner.nav, state.inner.body)

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and lets the low level follow it, see `Recorder`."""
        env = self.levels.env
        direction = self.high.policy(state.obs, jax.random.fold_in(state.key, facade.HIGH_STREAM))
        next_key, low_key = jax.random.split(state.key)
        subgoal, body = env.begin(state, direction)

        def advance(
            carry: tuple[physics_maze.Body, Int[Array, ""]], key: Key[Array, ""]
        ) -> tuple[tuple[physics_maze.Body, Int[Array, ""]], Steps]:
            body, num_steps = carry
            ctrl = self.levels.low_policy(env.low_obs(subgoal, body), key)
            moved = env.control(subgoal, body, ctrl)

            # As in `GoalMaze`, whose decisions are control steps.
            before = subgoal.nav.replace(visited=body.visited, decisions=num_steps)
            xy = moved.physics.qpos[None, :2]
            nav, outcome = task.advance(self.maze.table, before, xy, self.gym_task.reward_kind)
            step = Steps(
                shown=self._show(nav, moved),
                action=ctrl,
                direction=direction,
                outcome=outcome.terminated_if(moved.is_broken),
                is_running=body.is_running,
            )
            return (moved, num_steps + 1), step

        k = env.robot.steps_per_subgoal
        first = body, state.inner.nav.decisions * k
        (body, _), steps = jax.lax.scan(advance, first, jax.random.split(low_key, k))
        following = env.end(state.replace(key=next_key), body, steps.shown.infos["qpos"][:, :2])
        return tree.where(state.is_over, state, following), steps

    def _show(self, nav: task.Navigation, body: physics_maze.Body) -> Shown:
        """Returns what is recorded of a state."""
        obs = self.maze.observe(nav, body.physics)
        infos = {"qpos": body.physics.qpos, "qvel": body.physics.qvel, "goal": obs.goal_xy}
        return Shown(self.gym_task.see(obs), infos)


@dataclasses.dataclass(frozen=True)
class ByOracle:
    """A robot with oracle movement, recorded decision by decision.

    Attributes:
      high: chooses directions.
      env: the maze.
      gym_task: gives the observations of `eihrl_jax/HighLevel-v0`.
    """

    high: loading.HighLevel
    env: oracle_maze.OracleMaze
    gym_task: HighLevelTask

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins an episode, see `Recorder`."""
        state = self.env.reset(key, jnp.int32(0))
        return state, self._show(state)

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and moves the robot, see `Recorder`."""
        direction = self.high.policy(state.obs, jax.random.fold_in(state.key, facade.HIGH_STREAM))
        following = self.env.step(state, direction)
        step = Steps(
            shown=self._show(following),
            action=direction,
            direction=direction,
            outcome=base.Outcome(following.reward, following.terminated, following.truncated),
            is_running=~state.is_over,
        )
        following = tree.where(state.is_over, state, following)
        return following, jax.tree.map(lambda leaf: leaf[None], step)

    def _show(self, state: EnvState) -> Shown:
        """Returns what is recorded of a state."""
        goal_xy = task.current_goal_xy(self.env.table, state.inner.nav, state.inner.xy)
        return Shown(self.gym_task.see(state.obs), {"xy": state.inner.xy, "goal": goal_xy})
