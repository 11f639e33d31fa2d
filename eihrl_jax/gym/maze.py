"""A robot in a maze, one control step at a time, as an environment of Gymnasium.

The task is that of `goal_maze`; a learner observes what the baselines observe.

Observation, form "flat": float32 [5 + P], P the robot's proprioception.

| index | meaning | unit |
|---|---|---|
| 0, 1 | x and y of the torso, from the maze's centre | units |
| 2 … 1 + P | qpos without x and y, then qvel | units, radians, per second |
| 2 + P, 3 + P | x and y of the current goal, from the maze's centre | units |
| 4 + P | control steps since the episode's start / 1,000 | |

Form "goal", for mazes of one goal: a dict of `observation`, the same without the goal, float32
[3 + P]; `achieved_goal`, x and y of the torso; and `desired_goal`, x and y of the goal. Then there
is also `compute_reward`, which gives the reward of every step.

Action: float32 [A], controls in [-1, 1].
Reward, ends of an episode and reset: those of `goal_maze`.
Info: the metrics of `goal_maze`, so far in the episode, and `is_success`, whether all goals have
been visited.
"""

import dataclasses
import functools
import os
from typing import Any, Literal, cast, get_args

import jax.numpy as jnp
import numpy as np
from gymnasium import spaces, vector
from jaxtyping import Array, Float, Int

from eihrl_jax import base, robots
from eihrl_jax.config import checks
from eihrl_jax.envs import body, goal_maze, task
from eihrl_jax.gym import envs, episodes, places
from eihrl_jax.robots import robot as robot_lib

Form = Literal["flat", "goal"]
"""Form of an observation: one vector, or a dict with the goal separate."""


@dataclasses.dataclass(frozen=True)
class MazeTask:
    """A robot in a maze, see the module.

    Attributes:
      robot: the robot.
      maze: the maze.
      reward_kind: sparse or dense.
      engine: physics engine.
      observation: form of the observation, flat or goal.
    """

    robot: robot_lib.Robot
    maze: places.HostMaze
    reward_kind: base.Reward
    engine: base.EngineName
    observation: Form

    def __post_init__(self) -> None:
        """Checks the arguments, each and together."""
        checks.one_of("reward", self.reward_kind, base.REWARDS)
        checks.one_of("engine", self.engine, base.ENGINES)
        checks.one_of("observation", self.observation, get_args(Form))
        places.engine_of(self.robot, self.engine)  # raises if the robot can't be used
        if self.observation == "goal":
            self._check_goal()

    def spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Returns the spaces of what one robot observes and does."""
        return _spaces(self)

    def environment(self) -> goal_maze.GoalMaze:
        """Builds the environment."""
        physics = places.engine_of(self.robot, self.engine)
        return goal_maze.GoalMaze(physics, self.maze.stacked(), reward=self.reward_kind)

    def see(self, obs: base.GoalObs) -> Array | dict[str, Array]:
        """Converts the environment's observation to one of the observation space."""
        centre_xy = jnp.asarray(self.centre_xy)
        xy, goal_xy = obs.xy - centre_xy, obs.goal_xy - centre_xy
        if self.observation == "flat":
            return jnp.concatenate([xy, obs.proprioception, goal_xy, obs.time[None]])
        own = jnp.concatenate([xy, obs.proprioception, obs.time[None]])
        return {"observation": own, "achieved_goal": xy, "desired_goal": goal_xy}

    @property
    def fps(self) -> int:
        """Pictures per second at which a video runs in real time."""
        return max(1, round(1.0 / self.robot.control_step))

    def nav(self, inner: goal_maze.GoalMazeState) -> task.Navigation:
        """Returns the episode's navigation state."""
        return inner.nav

    def qpos(self, inner: goal_maze.GoalMazeState) -> Float[Array, "N nq"]:
        """Returns the postures of N episodes."""
        return inner.physics.qpos

    def reward(
        self, final: episodes.Shown, reward: Float[np.ndarray, " N"]
    ) -> Float[np.ndarray, " N"]:
        """Returns the environment's reward, or with goals that of `compute_reward`."""
        if self.observation == "flat":
            return reward
        # Equal to the last bit to what hindsight learners compute for other goals.
        return np.asarray(self.compute_reward(final["achieved_goal"], final["desired_goal"]))

    def compute_reward(
        self,
        achieved_goal: Float[np.ndarray, "*n 2"],
        desired_goal: Float[np.ndarray, "*n 2"],
        info: object = None,
    ) -> Float[np.ndarray, "*n"] | np.float32:
        """Returns the reward of a place, given the desired one.

        Args:
          achieved_goal: x and y of the torso, from the maze's centre, units.
          desired_goal: x and y of the goal.
          info: not used.

        Returns:
          float32, one for each row. Sparse: 1 where both are in the same cell, or in the same goal
          region of the maze, else 0. Dense: 1 / (1 + distance).
        """
        del info
        achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
        if self.reward_kind == "dense":
            distance = np.linalg.norm(achieved - desired, axis=-1)
            return np.float32(1.0 / (1.0 + distance))
        return np.float32(self._region(achieved) == self._region(desired))

    @property
    def centre_xy(self) -> Float[np.ndarray, "2"]:
        """The maze's centre, units, which observations count from: inputs are around zero."""
        num_rows, num_columns = self.maze.maze.wall.shape
        return np.array([num_columns, -num_rows], np.float32) * np.float32(base.CELL / 2)

    def _region(self, xy: Float[np.ndarray, "*n 2"]) -> Int[np.ndarray, "*n"]:
        """Returns the number of the region or cell at positions from the maze's centre."""
        regions, place = _regions(self.maze), (xy + self.centre_xy) / base.CELL
        i = np.floor(-place[..., 1]).astype(int).clip(0, regions.shape[0] - 1)
        j = np.floor(place[..., 0]).astype(int).clip(0, regions.shape[1] - 1)
        return np.asarray(regions[i, j])

    def _check_goal(self) -> None:
        """Checks that there is one goal.

        Raises:
          base.UserError: there are several.
        """
        if self.maze.num_goals != 1:
            raise base.UserError(
                f"observation = 'goal' is for mazes of one goal, this one has {self.maze.num_goals}"
            )


@functools.lru_cache(maxsize=16)
def _regions(maze: places.HostMaze) -> np.ndarray:
    """Returns the numbers of a maze's regions."""
    return maze.regions()


@functools.lru_cache(maxsize=16)
def _spaces(task: MazeTask) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """Returns the spaces of a task."""
    model = places.engine_of(task.robot, task.engine).model
    side_xy = np.abs(task.centre_xy)
    # Where a simulation counts as broken down; Gymnasium wants bounds that are finite.
    body_high = np.full(model.nq - 2 + model.nv, body.MAX_VELOCITY, np.float32)
    # One step more than there is, for JAX may round otherwise.
    num_steps = int(task.maze.maze.num_decisions) * task.robot.steps_per_subgoal + 1
    time_high = np.array([num_steps / base.TIME_UNIT], np.float32)

    def box(*high: np.ndarray, low_time: int = 0) -> spaces.Box:
        highest = np.concatenate(high)
        lowest = -highest
        if low_time:
            lowest[-1] = 0.0
        return spaces.Box(lowest, highest, dtype=np.float32)

    action = spaces.Box(-1.0, 1.0, (model.nu,), np.float32)
    if task.observation == "flat":
        return box(side_xy, body_high, side_xy, time_high, low_time=1), action
    goal = {"achieved_goal": box(side_xy), "desired_goal": box(side_xy)}
    own = box(side_xy, body_high, time_high, low_time=1)
    return spaces.Dict({"observation": own, **goal}), action


class MazeEnv(envs.SingleEnv):
    """One robot in one maze; see the module."""

    def __init__(
        self,
        maze: str | os.PathLike[str] = "u",
        robot: str = "ant",
        reward: str = "sparse",
        engine: str = "mujoco",
        num_decisions: int | None = None,
        observation: str = "flat",
        render_mode: str | None = None,
    ):
        """Compiles nothing yet.

        Args:
          maze: name of a maze, or path of a text file.
          robot: name of a robot, or path of its file.
          reward: sparse or dense.
          engine: mujoco or mjx.
          num_decisions: time limit in subgoals of the robot, some control steps each; None: the
            maze's own.
          observation: flat or goal.
          render_mode: "rgb_array" for pictures by `render`, see `drawing.snapshot`.

        Raises:
          base.UserError: an argument is unknown or out of its limits.
        """
        made = _make(maze, robot, reward, engine, num_decisions, observation)
        super().__init__(made, render_mode)
        # An attribute of this form alone: by it others know environments with goals.
        if observation == "goal":
            self.compute_reward = made.compute_reward


class MazeVectorEnv(envs.ParallelEnv):
    """Robots in parallel, one compiled step for all; see the module and `envs.ParallelEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        maze: str | os.PathLike[str] = "u",
        robot: str = "ant",
        reward: str = "sparse",
        engine: str = "mujoco",
        num_decisions: int | None = None,
        observation: str = "flat",
        autoreset_mode: str | vector.AutoresetMode = vector.AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ):
        """Compiles nothing yet.

        Args:
          num_envs: number N of robots, each with a leading row of every array.
          maze: see `MazeEnv`, like all that follow but for the mode.
          robot: see there.
          reward: see there.
          engine: see there.
          num_decisions: see there.
          observation: see there.
          autoreset_mode: what follows the end of an episode, see `envs.ParallelEnv`; as default
            what Gymnasium's own vector environments do.
          render_mode: see there.

        Raises:
          base.UserError: an argument is unknown or out of its limits.
        """
        made = _make(maze, robot, reward, engine, num_decisions, observation)
        super().__init__(made, num_envs, autoreset_mode, render_mode)
        if observation == "goal":
            self.compute_reward = made.compute_reward


def _make(
    maze: str | os.PathLike[str],
    robot: str,
    reward: str,
    engine: str,
    num_decisions: int | None,
    observation: str,
) -> MazeTask:
    """Builds the task, which checks the arguments."""
    return MazeTask(
        robots.load(robot),
        places.HostMaze.load(maze, num_decisions),
        cast(base.Reward, reward),
        cast(base.EngineName, engine),
        cast(Form, observation),
    )
