"""The Python interface in a few lines: load both levels by name and run them in any maze."""

import dataclasses
import functools
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.envs import hierarchy, physics_maze
from eihrl_jax.evaluation import loading, recording
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import tree
from eihrl_jax.physics import engines
from eihrl_jax.reporting import evaluations
from eihrl_jax.robots import robot as robot_lib

BEST = "best"
"""Name for the high level that `evaluate` takes by default."""

HIGH_STREAM = 0x6869_6768
"""Folded into a state's key for the high level, so that its draws differ from the robot's."""


def load(
    high: str = BEST,
    *,
    robot: str = "ant",
    low: str | None = None,
    engine: base.EngineName = "mujoco",
) -> "LoadedHierarchy":
    """Loads both levels.

    Args:
      high: as `evaluate --high` takes it; "best" for the best one that is shipped.
      robot: a shipped robot's name, or a description file.
      low: run folder, policy folder or shipped name; None: the robot's shipped one.
      engine: physics engine.

    Raises:
      base.UserError: one of them is unknown, damaged, or doesn't fit the others.

    >>> hierarchy = load("best", robot="point")
    >>> episode = hierarchy.run("u", seed=0)
    >>> episode.success
    1.0
    """
    name = evaluate_config.EvaluateConfig().high[0] if high == BEST else high
    loaded_robot = robots.load(robot)
    return LoadedHierarchy(
        high=loading.load_high(name),
        robot=loaded_robot,
        low_policy=loading.load_low(low or robot, loaded_robot),
        engine=engine,
    )


@dataclasses.dataclass(frozen=True)
class LoadedHierarchy:
    """A high level, and a robot with its low level.

    Attributes:
      high: chooses directions.
      robot: the robot.
      low_policy: its low level.
      engine: name of the physics engine.
    """

    high: loading.HighLevel
    robot: robot_lib.Robot
    low_policy: hierarchy.LowPolicy
    engine: base.EngineName

    def run(self, maze: str | pathlib.Path, seed: int = 0) -> "Episode":
        """Runs one episode; for many in the same maze, `into` compiles once.

        Args:
          maze: a name or a text file.
          seed: of all draws: start, door, directions.
        """
        return self.into(maze).run(seed)

    def into(self, *names: str | pathlib.Path) -> "LoadedMaze":
        """Returns an environment of one or several mazes in which both levels act."""
        loaded = tuple(mazes.load(name) for name in names)
        stacked = mazes.stack(list(loaded))
        env = loading.full_env(
            engines.make(self.robot, self.engine),
            stacked,
            self.high.view_in(stacked),
            self.low_policy,
            anchored=self.high.anchors(self.robot),
        )
        return LoadedMaze(self, loaded, env)


@dataclasses.dataclass(frozen=True, eq=False)
class LoadedMaze:
    """Mazes in which a hierarchy acts; `reset` and `step` work under `jit` and `vmap`.

    >>> both = load(robot="point").into("u", "s")
    >>> keys = jax.random.split(jax.random.key(0), 2)
    >>> states = jax.jit(jax.vmap(both.reset))(keys, jnp.arange(2))  # one in each
    >>> states = jax.jit(jax.vmap(both.step))(states)
    >>> states.metrics["decisions"].tolist()
    [1.0, 1.0]

    Attributes:
      levels: both levels.
      mazes: in the order in which they were named.
      env: the same environment, with the direction as its action.
    """

    levels: LoadedHierarchy
    mazes: tuple[mazes.Maze, ...]
    env: hierarchy.Hierarchy

    def reset(
        self, key: Key[Array, ""], maze: Int[Array, ""] | None = None
    ) -> physics_maze.EnvState:
        """Draws a new episode, in a given maze or in any; the key is consumed."""
        return self.env.reset(key, maze)

    def step(self, state: physics_maze.EnvState) -> physics_maze.EnvState:
        """Makes one decision and follows it; a state that is over stays as it is."""
        return self.trace(state)[0]

    def trace(
        self, state: physics_maze.EnvState
    ) -> tuple[physics_maze.EnvState, recording.Decision]:
        """Makes one decision and follows it; also returns the path."""
        key = jax.random.fold_in(state.key, HIGH_STREAM)
        action = self.levels.high.policy(state.obs, key)
        following, trace = self.env.trace(state, action)
        # The state of an episode that is over stays while others of a batch go on.
        following = tree.where(state.is_over, state, following)
        return following, recording.Decision.of(state.obs, action, trace)

    @functools.cached_property
    def _compiled(self) -> tuple[jax.stages.Wrapped, jax.stages.Wrapped]:
        reset = jax.jit(self.reset, compiler_options=base.QUICK_COMPILE)
        return reset, jax.jit(self.trace)

    def run(self, seed: int = 0, maze: int = 0) -> "Episode":
        """Runs one episode.

        Args:
          seed: of all draws: start, door, directions.
          maze: index of the maze.
        """
        reset, trace = self._compiled
        state = reset(jax.random.key(seed), jnp.int32(maze))
        history: list[recording.Decision] = []
        while not state.is_over:
            state, decision = trace(state)
            history.append(jax.device_get(decision))

        # Drawn with the door that the episode had.
        decisions = jax.tree.map(lambda *leaves: np.stack(leaves), *history)
        opened = maze_lib.open_door(self.mazes[maze], jnp.asarray(state.inner.nav.door_ij))
        obs = jax.ShapeDtypeStruct(state.obs.shape, bool)
        return Episode(
            success=float(state.metrics["success"]),
            num_decisions=len(history),
            has_fallen=bool(state.metrics["fell"] > 0.0),
            recording=recording.of_episode(opened, decisions, obs),
            robot=self.levels.robot,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """A finished episode.

    Attributes:
      success: share of the goals that were reached.
      num_decisions: that it took.
      has_fallen: whether the robot ever fell.
      recording: all of its moves.
      robot: the robot.
    """

    success: float
    num_decisions: int
    has_fallen: bool
    recording: recording.Recording
    robot: robot_lib.Robot

    def save(self, path: str | pathlib.Path, *, title: str = "") -> None:
        """Draws the episode as an animation, GIF or MP4.

        Raises:
          base.UserError: the name ends in something else, or MP4 can't be written here.
        """
        file = pathlib.Path(path)
        evaluations.animate(file, self.recording, self.robot, title or self.robot.name)
