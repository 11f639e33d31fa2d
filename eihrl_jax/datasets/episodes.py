"""Episodes with all that a dataset tells of them, many at once."""

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
"""Of a maze by decisions, moved by the oracle or walking."""

Infos: TypeAlias = dict[str, Array]


class Shown(NamedTuple):
    """What a dataset tells of a moment.

    Attributes:
      obs: as the Gymnasium environment shows it.
      infos: what it tells besides.
    """

    obs: PyTree[Array]
    infos: Infos


class Steps(struct.PyTreeNode):
    """What a decision led to, in k steps of the dataset.

    Attributes:
      shown: after each of them.
      action: what was done.
      direction: int32, the subgoal that was followed.
      outcome: of the step.
      is_running: whether the episode went on through it; else nothing of it counts.
    """

    shown: Shown
    action: Array
    direction: Int[Array, " k"]
    outcome: base.Outcome
    is_running: Bool[Array, " k"]


@runtime_checkable
class Teller(Protocol):
    """Runs episodes of a hierarchy and tells them."""

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins the episode of the Gymnasium environment with that seed's key."""
        ...

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and follows it; an episode that is over rests."""
        ...


@dataclasses.dataclass(frozen=True)
class Walking:
    """A robot that walks, told control step by control step.

    Attributes:
      high: chooses directions.
      levels: the robot in the maze, with its low level.
      maze: the same as `eihrl_jax/Maze-v0` has it.
      gym_task: shows it.
    """

    high: loading.HighLevel
    levels: hierarchy.Hierarchy
    maze: goal_maze.GoalMaze
    gym_task: MazeTask

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins an episode, see `Teller`."""
        state = self.levels.reset(key, jnp.int32(0))
        return state, self._show(state.inner.nav, state.inner.body)

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and walks it, see `Teller`."""
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

            # As `GoalMaze` has it, which counts and pays control steps.
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
        """Returns what is told of a moment."""
        obs = self.maze.observe(nav, body.physics)
        infos = {"qpos": body.physics.qpos, "qvel": body.physics.qvel, "goal": obs.goal_xy}
        return Shown(self.gym_task.see(obs), infos)


@dataclasses.dataclass(frozen=True)
class ByOracle:
    """A robot that the simulator moves, told decision by decision.

    Attributes:
      high: chooses directions.
      env: the maze.
      gym_task: shows it as `eihrl_jax/HighLevel-v0` does.
    """

    high: loading.HighLevel
    env: oracle_maze.OracleMaze
    gym_task: HighLevelTask

    def reset(self, key: Key[Array, ""]) -> tuple[EnvState, Shown]:
        """Begins an episode, see `Teller`."""
        state = self.env.reset(key, jnp.int32(0))
        return state, self._show(state)

    def decide(self, state: EnvState) -> tuple[EnvState, Steps]:
        """Makes a decision and is moved, see `Teller`."""
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
        """Returns what is told of a moment."""
        goal_xy = task.current_goal_xy(self.env.table, state.inner.nav, state.inner.xy)
        return Shown(self.gym_task.see(state.obs), {"xy": state.inner.xy, "goal": goal_xy})
