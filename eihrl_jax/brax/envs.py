"""Our environments of one robot as `brax.envs.Env`: the maze, and the low level's task.

Both run the episodes of the bare environment with the same key, digit for digit.

As everywhere in Brax they have no time limit: the wrapper of the training gives them one, for which
they have `episode_steps`, and `info["time_out"]` is 1 from the bare environment's own limit on.
`done` is what ends an episode for good.

Metrics are those of the bare environment, but what each step adds to them: Brax sums them over an
episode. All are float32.
"""

import abc
import dataclasses
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from jaxtyping import Array, Float, Key, UInt32

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import goal_maze, locomotion, low_obs
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines
from eihrl_jax.robots import robot as robot_lib

State = envs.State

EnvState = base.EnvState[Any, Any]
"""The state of any of our environments; its key is raw in Brax's states, as Brax's own are."""


class RobotEnv(envs.Env):
    """What our environments of Brax have in common.

    Attributes:
      episode_steps: the bare environment's own time limit, control steps.
    """

    def __init__(self, bare: base.Environment, engine: engine_lib.Engine, episode_steps: int):
        """Takes the bare environment and what moves its robot."""
        self._bare = bare
        self._engine = engine
        self.episode_steps = episode_steps

    @abc.abstractmethod
    def see(self, obs: Any) -> Float[Array, " F"]:
        """Returns an observation of the bare environment as a vector."""

    def control(self, action: Float[Array, " nu"], obs: Any) -> Float[Array, " nu"]:
        """Returns the robot's controls of an action, in [-1, 1]."""
        del obs
        return action

    def gain(
        self, before: dict[str, Float[Array, ""]], after: dict[str, Float[Array, ""]]
    ) -> dict[str, Float[Array, ""]]:
        """Returns what a step adds to the metrics of an episode."""
        return {name: value - before[name] for name, value in after.items()}

    def reset(self, rng: Key[Array, ""] | UInt32[Array, "2"]) -> State:
        """Draws a new episode; the key is consumed."""
        bare = self._bare.reset(_typed(rng))
        zero = jnp.float32(0.0)
        return State(
            pipeline_state=_with_raw_key(bare),
            obs=self.see(bare.obs),
            reward=zero,
            done=zero,
            metrics={name: zero for name in bare.metrics},
            info={"time_out": zero},
        )

    def step(self, state: State, action: Float[Array, " nu"]) -> State:
        """Advances one control step, whether or not the bare environment's time is up."""
        before = _with_typed_key(state.pipeline_state)
        # With its flags the bare environment would rest at its own limit, before Brax's.
        no = jnp.zeros_like(before.terminated)
        after = self._bare.step(
            before.replace(terminated=no, truncated=no), self.control(action, before.obs)
        )

        # What wrappers have added to either dict stays.
        return dataclasses.replace(
            state,
            pipeline_state=_with_raw_key(after),
            obs=self.see(after.obs),
            reward=after.reward,
            done=after.terminated.astype(jnp.float32),
            metrics=state.metrics | self.gain(before.metrics, after.metrics),
            info=state.info | {"time_out": after.truncated.astype(jnp.float32)},
        )

    @property
    def observation_size(self) -> int:
        """Size F of an observation."""
        key = jax.eval_shape(jax.random.key, 0)
        return jax.eval_shape(lambda key: self.see(self._bare.reset(key).obs), key).shape[0]

    @property
    def action_size(self) -> int:
        """Number of the robot's motors."""
        return self._engine.model.nu

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return "mjx" if type(self._engine).__name__.startswith("Mjx") else "mujoco"

    @property
    def dt(self) -> float:
        """Seconds of a step."""
        return self._engine.robot.control_step


class MazeEnv(RobotEnv):
    """A robot in a maze, or in a different one in every episode; see `envs.goal_maze`.

    Observation: float32 [4 + P], P the robot's proprioception.

    | index | meaning | unit |
    |---|---|---|
    | 0, 1 | x and y of the torso, from the maze's centre | units |
    | 2 … 1 + P | qpos without x and y, then qvel | units, radians, per second |
    | 2 + P, 3 + P | x and y of the current goal, from the maze's centre | units |

    Action: float32 [A], controls in [-1, 1].

    Attributes:
      bare: the bare environment.
      state_dim: size 2 + P of what an observation tells of the robot; the goal comes after it.
      goal_indices: where in it stands what a goal is about, as JaxGCRL's learners want it.
      goal_reach_thresh: distance in units from a goal's centre at which they count it as reached.
    """

    goal_reach_thresh = base.CELL / 2.0

    def __init__(
        self,
        maze: str | os.PathLike[str] | mazes.Maze = "u",
        robot: str | robot_lib.Robot = "ant",
        *,
        reward: base.Reward = "sparse",
        engine: base.EngineName = "mujoco",
        num_decisions: int | None = None,
    ):
        """Builds the maze; compiles nothing yet.

        Args:
          maze: a name or a file, or one that is loaded already; or several with a leading axis, of
            which each episode draws one.
          robot: a name or a file, or one that is loaded already.
          reward: sparse or dense.
          engine: mujoco or mjx.
          num_decisions: time limit in subgoals of a maze that is named here; None: its own.

        Raises:
          base.UserError: one of them is unknown or not as it should be.
        """
        if not isinstance(robot, robot_lib.Robot):
            robot = robots.load(robot)
        if not isinstance(maze, mazes.Maze):
            maze = mazes.load(os.fspath(maze), num_decisions=num_decisions)
        self._take(goal_maze.GoalMaze(engines.make(robot, engine), maze, reward=reward))

    @classmethod
    def of(cls, bare: goal_maze.GoalMaze) -> "MazeEnv":
        """Makes one of a maze that is built already."""
        env = cls.__new__(cls)
        env._take(bare)
        return env

    def _take(self, bare: goal_maze.GoalMaze) -> None:
        """Takes the bare environment."""
        super().__init__(bare, bare.engine, int(bare.table.mazes.num_decisions.max()))
        self.bare = bare
        self.goal_indices = np.arange(2)
        self.state_dim = bare.engine.model.nq + bare.engine.model.nv
        width, height = bare.side_xy
        self._centre_xy = np.array([width / 2.0, -height / 2.0], np.float32)

    def see(self, obs: base.GoalObs) -> Float[Array, " F"]:
        """Returns an observation as a vector."""
        return see(obs, self._centre_xy)


def see(obs: base.GoalObs, centre_xy: Float[np.ndarray, "2"]) -> Float[Array, "*B F"]:
    """Returns what is seen in a maze as a vector, positions counted from its centre."""
    xy, goal_xy = (each - np.broadcast_to(centre_xy, each.shape) for each in (obs.xy, obs.goal_xy))
    return jnp.concatenate([xy, obs.proprioception, goal_xy], axis=-1)


class LocomotionEnv(RobotEnv):
    """A robot that follows directions which change every k steps; see `envs.locomotion`.

    Observation: float32 [F], the input of the low level's network, see `envs.low_obs.features`.
    Action: float32 [A] in [-1, 1], in the frame in which the network sees the world.

    Attributes:
      bare: the bare environment.
    """

    def __init__(self, config: low_config.LowConfig = presets.LOW["best"]):
        """Builds the task; compiles nothing yet.

        Args:
          config: what of a training run is the task's: robot, engine, input, and all that
            `Locomotion.of_config` takes.

        Raises:
          base.UserError: the robot is unknown or not as it should be.
        """
        built = engines.make(robots.load(config.robot), config.engine)
        self.bare = locomotion.Locomotion.of_config(built, config)
        super().__init__(self.bare, built, config.episode_steps)
        self._low_input = config.low_input

    def see(self, obs: low_obs.LowObs) -> Float[Array, " F"]:
        """Returns an observation as a vector."""
        return low_obs.features(obs, self.bare.robot, self._low_input)

    def control(self, action: Float[Array, " nu"], obs: low_obs.LowObs) -> Float[Array, " nu"]:
        """Returns the robot's controls of an action, in [-1, 1]."""
        return low_obs.ctrl_from_action(action, obs, self.bare.robot, self._low_input)

    def gain(
        self, before: dict[str, Float[Array, ""]], after: dict[str, Float[Array, ""]]
    ) -> dict[str, Float[Array, ""]]:
        """Returns the metrics of a step, which are of that step alone here."""
        del before
        return after


def _typed(rng: Array) -> Key[Array, ""]:
    """Returns a key of either kind as one of the kind that we use."""
    is_key = jnp.issubdtype(rng.dtype, jax.dtypes.prng_key)
    return rng if is_key else jax.random.wrap_key_data(rng)


def _with_raw_key(state: EnvState) -> Any:
    """Returns a state whose key is raw: Brax's learners can't take one that is no array."""
    # Any: Brax's type for it is that of its own physics, into which no wrapper looks.
    return state.replace(key=jax.random.key_data(state.key))


def _with_typed_key(state: Any) -> EnvState:
    """Undoes `_with_raw_key`."""
    return state.replace(key=jax.random.wrap_key_data(state.key))
