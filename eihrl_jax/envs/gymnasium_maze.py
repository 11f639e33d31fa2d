"""The mazes as Gymnasium environments, for learners from elsewhere.

    from eihrl_jax.envs import gymnasium_maze

    env = gymnasium_maze.MazeEnv(maze="u")
    envs = gymnasium_maze.MazeVectorEnv(64, maze="u")

The task is that of `goal_maze`, and a learner is told what our baselines are told. After
`register()` they are also found as `gymnasium.make(ID, maze="u")` and `gymnasium.make_vec`.

Observation: float32 [5 + P], P the robot's proprioception.

| index | meaning | unit |
|---|---|---|
| 0, 1 | x and y of the torso, from the maze's centre | units |
| 2 … 1 + P | qpos without x and y, then qvel | units, radians, per second |
| 2 + P, 3 + P | x and y of the current goal, from the maze's centre | units |
| 4 + P | control steps since the episode's start / 1,000 | |

Action: float32 [A], controls in [-1, 1].
Reward, ends of an episode and reset: those of `goal_maze`.
Info: the metrics of `goal_maze`, so far in the episode.

`pip install eihrl_jax[gym]` brings Gymnasium.
"""

import functools
from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias, cast

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces, vector
from jaxtyping import Array, Float

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs import goal_maze, wrappers
from eihrl_jax.physics import engines

ID = "eihrl_jax/Maze-v0"
"""Name under which Gymnasium knows both environments, once they are registered."""

Info: TypeAlias = dict[str, Any]
"""What is told beside the observation; Gymnasium lets it be anything."""


def register() -> None:
    """Makes `ID` known to Gymnasium."""
    where = "eihrl_jax.envs.gymnasium_maze"
    gymnasium.register(
        ID, entry_point=f"{where}:MazeEnv", vector_entry_point=f"{where}:MazeVectorEnv"
    )


class MazeEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot in one maze; see the module."""

    # `Any` here and in the signatures below is Gymnasium's own.
    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        maze: str = "u",
        robot: str = "ant",
        reward: str = "sparse",
        engine: str = "mujoco",
        num_decisions: int | None = None,
    ):
        """Compiles nothing yet.

        Args:
          maze: name of a maze, or path of a text file.
          robot: name of a robot, or path of its file.
          reward: sparse or dense.
          engine: mujoco or mjx.
          num_decisions: time limit in subgoals of the robot, some control steps each; None: the
            maze's own.

        Raises:
          base.UserError: one of them is unknown or not as it should be.
        """
        env, self.observation_space, self.action_space = _make(
            maze, robot, reward, engine, num_decisions
        )
        self._episodes = _Episodes(
            env.reset, env.step, functools.partial(features, side_xy=env.side_xy)
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, Info]:
        """Draws a new episode; there are no options."""
        super().reset(seed=seed, options=options)  # makes `np_random`
        return self._episodes.begin(self.np_random)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Advances one control step."""
        state = self._episodes.advance(action)
        obs = self._episodes.see(state.obs)
        return obs, float(state.reward), bool(state.terminated), bool(state.truncated), _info(state)


class MazeVectorEnv(vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Robots in parallel, one compiled step for all; see the module.

    A new episode begins in the step that ends one; its last observation and metrics are then in
    the info, `final_obs` and `final_info`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": vector.AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        maze: str = "u",
        robot: str = "ant",
        reward: str = "sparse",
        engine: str = "mujoco",
        num_decisions: int | None = None,
    ):
        """Compiles nothing yet.

        Args:
          num_envs: number N of robots, each with a leading row of every array.
          maze: see `MazeEnv`, like all that follow.
          robot: see there.
          reward: see there.
          engine: see there.
          num_decisions: see there.

        Raises:
          base.UserError: one of them is unknown or not as it should be.
        """
        if num_envs < 1:
            raise base.UserError(f"num_envs = {num_envs} is below 1")
        self.num_envs = num_envs
        env, self.single_observation_space, self.single_action_space = _make(
            maze, robot, reward, engine, num_decisions
        )
        self.observation_space = vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = vector.utils.batch_space(self.single_action_space, num_envs)

        resetting = wrappers.AutoReset(env)
        self._episodes = _Episodes(
            lambda key: jax.vmap(resetting.reset)(jax.random.split(key, num_envs)),
            jax.vmap(resetting.step),
            jax.vmap(functools.partial(features, side_xy=env.side_xy)),
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, Info]:
        """Draws new episodes in all rows; there are no options."""
        super().reset(seed=seed, options=options)
        return self._episodes.begin(self.np_random)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Advances every robot one control step, and into the next episode where one has ended."""
        state = self._episodes.advance(actions)
        terminated, truncated = np.asarray(state.terminated), np.asarray(state.truncated)
        is_over, info = terminated | truncated, _info(state)

        if is_over.any():
            # Gymnasium's names; those with an underscore say which rows are meant.
            info = {
                **info,
                "final_obs": self._episodes.see(state.final_obs),
                "_final_obs": is_over,
                "final_info": info,
                "_final_info": is_over,
            }

        obs = self._episodes.see(state.obs)
        return obs, np.asarray(state.reward), terminated, truncated, info


class _Episodes:
    """The running episode of one robot, or those of many, and the compiled functions of it."""

    def __init__(
        self,
        reset: Callable[[Array], goal_maze.EnvState],
        step: Callable[[goal_maze.EnvState, Array], goal_maze.EnvState],
        see: Callable[[base.GoalObs], Array],
    ):
        self._reset, self._step, self._see = jax.jit(reset), jax.jit(step), jax.jit(see)
        self._state: goal_maze.EnvState | None = None

    def begin(self, generator: np.random.Generator) -> tuple[np.ndarray, Info]:
        """Draws new episodes; returns what is seen, and the info."""
        # Gymnasium's generator is seeded only where a seed is given, so episodes go on differing.
        self._state = state = self._reset(jax.random.key(int(generator.integers(2**32))))
        return self.see(state.obs), _info(state)

    def advance(self, action: np.ndarray) -> goal_maze.EnvState:
        """Advances one control step."""
        if self._state is None:
            raise base.UserError("step was called before reset")
        self._state = state = self._step(self._state, jnp.asarray(action, jnp.float32))
        return state

    def see(self, obs: base.GoalObs) -> np.ndarray:
        """Returns observations as vectors."""
        return np.asarray(self._see(obs))


def features(obs: base.GoalObs, side_xy: tuple[int, int]) -> Float[Array, " F"]:
    """Returns an observation as one vector, F = 5 + P, see the module.

    Args:
      obs: of a `goal_maze.GoalMaze`.
      side_xy: its sides in units, its upper left corner at the origin.
    """
    # About the centre, so that mazes of any size are inputs around zero.
    centre_xy = jnp.array([side_xy[0] / 2.0, -side_xy[1] / 2.0], jnp.float32)
    parts = obs.xy - centre_xy, obs.proprioception, obs.goal_xy - centre_xy, obs.time[None]
    return jnp.concatenate(parts)


def _make(
    maze: str, robot: str, reward: str, engine: str, num_decisions: int | None
) -> tuple[goal_maze.GoalMaze, spaces.Box, spaces.Box]:
    """Builds the maze; also returns the spaces of what one robot observes and does."""
    if reward not in base.REWARDS:
        raise base.UserError(
            f"reward {reward!r} is unknown; choose one of {', '.join(base.REWARDS)}"
        )

    physics = engines.make(robots.load(robot), engine)
    loaded = mazes.load(maze, num_decisions=num_decisions)
    env = goal_maze.GoalMaze(physics, loaded, reward=cast(base.Reward, reward))

    # Shapes alone: nothing is compiled before the first reset.
    obs = jax.eval_shape(env.reset, jax.random.key(0)).obs
    num_features = jax.eval_shape(lambda obs: features(obs, env.side_xy), obs).shape
    return (
        env,
        spaces.Box(-np.inf, np.inf, num_features, np.float32),
        spaces.Box(-1.0, 1.0, (physics.model.nu,), np.float32),
    )


def _info(state: goal_maze.EnvState) -> Info:
    """Returns the metrics, of one robot or of many."""
    return {name: np.asarray(value) for name, value in state.metrics.items()}
