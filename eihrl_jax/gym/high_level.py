"""A robot in a maze, one decision at a time, as an environment of Gymnasium: for high levels.

A decision takes the robot a cell in some direction: moved by the simulator ("oracle", see
`envs.oracle_maze`), or walking with its low level ("full", see `envs.hierarchy`).

Observation: int8 of 0 and 1, what our high levels see, see `envs.raster`: a patch [P, P, 3] around
the robot, north up, with channels wall, unvisited goal and robot; or with a `map_radius` r a map of
cells [2 r + 1, 2 r + 1, 4] of what has been seen, whose fourth channel is what hasn't.
Action: the index of a direction in `base.DIRECTIONS_XY`: east, west, north, south.
Reward, ends of an episode and reset: those of `envs.task`.
Info: the metrics of the environment, so far in the episode, and `is_success`, whether all goals
have been visited.
"""

import dataclasses
import os
from typing import Any, cast, get_args

import jax.numpy as jnp
import numpy as np
from gymnasium import spaces, vector
from jaxtyping import Array, Float, Int8

from eihrl_jax import base, robots
from eihrl_jax.config import checks
from eihrl_jax.envs import hierarchy, oracle_maze, physics_maze, raster, subgoals, task
from eihrl_jax.evaluation import loading
from eihrl_jax.gym import envs, episodes, places
from eihrl_jax.robots import robot as robot_lib

_FPS = 4  # a decision takes seconds


@dataclasses.dataclass(frozen=True)
class HighLevelTask:
    """A robot that follows directions, see the module.

    Attributes:
      robot: the robot.
      maze: the maze.
      reward_kind: sparse or dense.
      movement: oracle or full.
      low: name of the low level that walks; not used by the oracle.
      view: size and channels of the observation.
      anchored: whether a subgoal counts from the middle of the robot's cell, see `task.anchor`.
    """

    robot: robot_lib.Robot
    maze: places.HostMaze
    reward_kind: base.Reward
    movement: base.MovementName
    low: str
    view: raster.View
    anchored: bool

    def __post_init__(self) -> None:
        """Checks the arguments."""
        checks.one_of("reward", self.reward_kind, base.REWARDS)
        checks.one_of("movement", self.movement, base.MOVEMENTS)
        places.engine_of(self.robot, "mujoco")  # says what is wrong with a robot

    @property
    def fps(self) -> int:
        """Pictures per second of a video, one per decision."""
        return _FPS

    def spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Returns the spaces of what a high level observes and decides."""
        return spaces.MultiBinary(self.view.obs_shape), spaces.Discrete(base.NUM_DIRECTIONS)

    def environment(self) -> oracle_maze.OracleMaze | hierarchy.Hierarchy:
        """Builds the environment.

        Raises:
          base.UserError: the robot has no such low level.
        """
        stacked = self.maze.stacked()
        if self.movement == "oracle":
            return oracle_maze.OracleMaze.of_robot(
                self.robot, stacked, view=self.view, anchored=self.anchored, reward=self.reward_kind
            )
        return loading.full_env(
            places.engine_of(self.robot, "mujoco"),
            stacked,
            self.view,
            loading.load_low(self.low, self.robot),
            anchored=self.anchored,
            reward=self.reward_kind,
        )

    def see(self, obs: raster.Picture) -> Int8[Array, "n m C"]:
        """Returns a picture as Gymnasium has it."""
        return obs.astype(jnp.int8)

    def nav(
        self, inner: oracle_maze.OracleMazeState | physics_maze.PhysicsMazeState
    ) -> task.Navigation:
        """Returns the episode's navigation state."""
        return inner.nav

    def qpos(
        self, inner: oracle_maze.OracleMazeState | physics_maze.PhysicsMazeState
    ) -> Float[Array, "N nq"]:
        """Returns the postures of N episodes."""
        if isinstance(inner, physics_maze.PhysicsMazeState):
            return inner.body.physics.qpos
        bank = subgoals.gait(self.robot, None, base.CELL, base.SIGMA).bank
        return jnp.asarray(bank.qpos)[inner.posture].at[:, :2].set(inner.xy)

    def reward(
        self, final: episodes.Shown, reward: Float[np.ndarray, " N"]
    ) -> Float[np.ndarray, " N"]:
        """Returns the environment's reward."""
        del final
        return reward


class HighLevelEnv(envs.SingleEnv):
    """One robot; see the module."""

    def __init__(
        self,
        maze: str | os.PathLike[str] = "random",
        robot: str = "ant",
        movement: str = "oracle",
        reward: str = "sparse",
        num_decisions: int | None = None,
        low: str | None = None,
        extent: float = 9.0,
        pixels: int = 15,
        map_radius: int = 0,
        knows: str = "nothing",
        anchored: bool = False,
        render_mode: str | None = None,
    ):
        """Compiles nothing yet.

        Args:
          maze: name of a maze, or path of a text file.
          robot: name of a robot, or path of its file.
          movement: oracle or full.
          reward: sparse or dense.
          num_decisions: time limit; None: the maze's own.
          low: low level of the full movement, a run folder, a policy folder or a shipped name;
            None: the robot's shipped one.
          extent: side of the patch, units.
          pixels: side of the patch, pixels.
          map_radius: cells to every side of the robot's on a map, which is seen instead; 0: none.
          knows: what is on the map from the start: nothing, goal or map.
          anchored: whether a subgoal counts from the middle of the robot's cell.
          render_mode: "rgb_array" for pictures by `render`, see `drawing.snapshot`.

        Raises:
          base.UserError: an argument is unknown or out of its limits.
        """
        view = _view(extent, pixels, map_radius, knows)
        made = _make(maze, robot, movement, reward, num_decisions, low, view, anchored)
        super().__init__(made, render_mode)


class HighLevelVectorEnv(envs.ParallelEnv):
    """Robots in parallel, one compiled step for all; see the module and `envs.ParallelEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        maze: str | os.PathLike[str] = "random",
        robot: str = "ant",
        movement: str = "oracle",
        reward: str = "sparse",
        num_decisions: int | None = None,
        low: str | None = None,
        extent: float = 9.0,
        pixels: int = 15,
        map_radius: int = 0,
        knows: str = "nothing",
        anchored: bool = False,
        autoreset_mode: str | vector.AutoresetMode = vector.AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ):
        """Compiles nothing yet.

        Args:
          num_envs: number N of robots, each with a leading row of every array.
          maze: see `HighLevelEnv`, like all that follow but for the mode.
          robot: see there.
          movement: see there.
          reward: see there.
          num_decisions: see there.
          low: see there.
          extent: see there.
          pixels: see there.
          map_radius: see there.
          knows: see there.
          anchored: see there.
          autoreset_mode: what follows the end of an episode, see `envs.ParallelEnv`.
          render_mode: see there.

        Raises:
          base.UserError: an argument is unknown or out of its limits.
        """
        view = _view(extent, pixels, map_radius, knows)
        made = _make(maze, robot, movement, reward, num_decisions, low, view, anchored)
        super().__init__(made, num_envs, autoreset_mode, render_mode)


def _view(extent: float, pixels: int, map_radius: int, knows: str) -> raster.View:
    """Returns size and channels of the observation."""
    checks.one_of("knows", knows, get_args(base.Knows))
    return raster.View(
        extent=extent, pixels=pixels, map_radius=map_radius, knows=cast(base.Knows, knows)
    )


def _make(
    maze: str | os.PathLike[str],
    robot: str,
    movement: str,
    reward: str,
    num_decisions: int | None,
    low: str | None,
    view: raster.View,
    anchored: bool,
) -> HighLevelTask:
    """Builds the task, which checks the arguments."""
    return HighLevelTask(
        robots.load(robot),
        places.HostMaze.load(maze, num_decisions),
        cast(base.Reward, reward),
        cast(base.MovementName, movement),
        low or robot,
        view,
        anchored,
    )
