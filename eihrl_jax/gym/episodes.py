"""Batches of episodes for Gymnasium's environments, with compiled steps and each autoreset mode.

Every row has its own random key, made from its seed and carried on from episode to episode. So a
row's episodes are those of the JAX environment with that key, whether it runs alone or in a batch,
and in every autoreset mode.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias, cast, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from gymnasium import spaces, vector
from jaxtyping import Array, Bool, Float, Int, Key, PyTree, UInt8, UInt32

from eihrl_jax import base
from eihrl_jax.drawing import snapshot
from eihrl_jax.envs import task as task_lib
from eihrl_jax.envs import wrappers
from eihrl_jax.gym import forks, places
from eihrl_jax.ops import batching, tree
from eihrl_jax.robots import robot as robot_lib

Mode = vector.AutoresetMode

Info: TypeAlias = dict[str, Any]
"""Gymnasium's `info`, whose values may be anything."""

Shown: TypeAlias = PyTree[np.ndarray]
"""Observations in Gymnasium's form: arrays, or a dict of arrays."""

EnvState: TypeAlias = base.EnvState[Any, Any]
"""The state of any of our environments."""


@runtime_checkable
class PlacedEnvironment(Protocol):
    """A maze environment whose episodes can begin at a given place."""

    def reset(
        self,
        key: Key[Array, ""],
        maze: Int[Array, ""] | None = None,
        place: task_lib.Place | None = None,
    ) -> EnvState:
        """Draws a new episode, in a given maze and place or in any; the key is consumed."""
        ...

    def step(self, state: EnvState, action: Array) -> EnvState:
        """Advances one step."""
        ...


@runtime_checkable
class Task(Protocol):
    """What one robot observes, does and is rewarded for; JAX starts when `environment` is called.

    Tasks are hashable, and equal if their compiled programs are the same.

    Attributes:
      maze: the maze.
      robot: the robot.
      fps: pictures per second at which a video runs in real time.
    """

    @property
    def maze(self) -> places.HostMaze:
        """The maze."""
        ...

    @property
    def robot(self) -> robot_lib.Robot:
        """The robot."""
        ...

    @property
    def fps(self) -> int:
        """Pictures per second at which a video runs in real time."""
        ...

    def spaces(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Returns the observation space and the action space of one robot."""
        ...

    def environment(self) -> PlacedEnvironment:
        """Builds the environment."""
        ...

    def see(self, obs: Any) -> PyTree[Array]:
        """Converts the environment's observation to one of the observation space."""
        ...

    def nav(self, inner: Any) -> task_lib.Navigation:
        """Returns the episode's navigation state."""
        ...

    def qpos(self, inner: Any) -> Float[Array, "N nq"]:
        """Returns the postures of N episodes."""
        ...

    def reward(self, final: Shown, reward: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
        """Returns the reward, given the last observation and the environment's reward."""
        ...


class Outcomes(struct.PyTreeNode):
    """The outcome of a step in each of N rows.

    Attributes:
      obs: current observation, of a new episode where one began with this step.
      final: observation after the action, of the old episode even where a new one began.
      reward: see `base.Outcome`, like the next two.
      terminated: the episode ended for good.
      truncated: the episode was cut by its time limit.
      metrics: of the episode that the action belongs to.
      is_stepped: whether the action was used; false where the step began an episode instead, or
        the episode was already over.
    """

    obs: PyTree[Array]
    final: PyTree[Array]
    reward: Float[Array, " N"]
    terminated: Bool[Array, " N"]
    truncated: Bool[Array, " N"]
    metrics: dict[str, Float[Array, " N"]]
    is_stepped: Bool[Array, " N"]


class Step(NamedTuple):
    """`Outcomes` as writable NumPy arrays.

    Attributes:
      obs: current observation, [N, …].
      final: observation after the action, [N, …].
      reward: float32 [N].
      terminated: bool [N].
      truncated: bool [N].
      info: metrics of the episodes that the actions belong to, float32 [N] each.
    """

    obs: Shown
    final: Shown
    reward: Float[np.ndarray, " N"]
    terminated: Bool[np.ndarray, " N"]
    truncated: Bool[np.ndarray, " N"]
    info: Info


class Rows:
    """N episodes and their compiled programs; a copy continues as the original would."""

    def __init__(self, task: Task, num: int, mode: Mode = Mode.DISABLED):
        """Compiles nothing yet.

        Args:
          task: the same for every row.
          num: number of rows, N.
          mode: when a new episode follows the end of one.
        """
        self.task = task
        self.num = num
        self.mode = mode
        self._state: EnvState | None = None

    def reset(
        self,
        seeds: Sequence[int] | None,
        options: places.Options,
        generator: np.random.Generator,
    ) -> tuple[Shown, Info]:
        """Begins new episodes, in all rows or in those of a mask; returns what all rows see.

        Args:
          seeds: for the rows' keys; None: keys are carried on, or drawn at the first reset.
          options: those of `places.choose`, and `reset_mask`, bool [N].
          generator: draws seeds, and a start or goal where only the other one is given.

        Raises:
          base.UserError: an option has a wrong value, or the mask keeps rows without an episode.
        """
        mask = self._mask(options)
        chosen = places.choose(self.task.maze, options, self.num, generator)

        programs = _programs(self.task, self.mode)
        if seeds is None and self._state is None:
            seeds = generator.integers(2**32, size=self.num).tolist()
        if seeds is not None:
            # JAX takes 32 bits of a seed.
            keys = programs.keys(np.array([seed % 2**32 for seed in seeds], np.uint32))
        else:
            keys = cast(EnvState, self._state).key
        state: EnvState = programs.reset(keys, chosen)

        # The other rows stay as they are, also if their episodes are over.
        self._state = state if mask is None else programs.choose(mask, state, self._state)
        return _arrays(programs.see(self._state.obs)), _info(_arrays(self._state.metrics))

    def step(self, action: Any) -> Step:
        """Advances every row one step.

        Raises:
          base.UserError: no episode has begun, or the actions don't fit the action space.
        """
        if self._state is None:
            raise base.UserError("step was called before reset")
        action = self._action(action)

        self._state, outcomes = _programs(self.task, self.mode).step(self._state, action)
        outcomes = _arrays(outcomes)
        reward = self.task.reward(outcomes.final, outcomes.reward)
        return Step(
            obs=outcomes.obs,
            final=outcomes.final,
            reward=np.where(outcomes.is_stepped, reward, np.float32(0.0)),
            terminated=outcomes.terminated,
            truncated=outcomes.truncated,
            info=_info(outcomes.metrics),
        )

    def draw(self, painter: snapshot.Painter) -> list[UInt8[np.ndarray, "H W 3"]]:
        """Draws every row.

        Raises:
          base.UserError: no episode has begun.
        """
        if self._state is None:
            raise base.UserError("render was called before reset")
        nav, qpos = jax.device_get(
            (self.task.nav(self._state.inner), self.task.qpos(self._state.inner))
        )

        pictures = []
        for i in range(self.num):
            maze = self.task.maze.opened(int(nav.maze[i]), nav.door_ij[i])
            pictures.append(painter.draw(maze, nav.visited[i], qpos[i]))
        return pictures

    def _action(self, action: Any) -> np.ndarray:
        """Checks actions, and returns them as an array [N, …]."""
        _, space = self.task.spaces()
        shape = (self.num, *cast(tuple[int, ...], space.shape))
        is_index = isinstance(space, spaces.Discrete)
        kind, words = (np.int64, "whole numbers") if is_index else (np.float64, "numbers")
        try:
            array = np.asarray(action)
        except ValueError:  # rows of different lengths
            raise base.UserError(f"action {action!r} is not an array") from None

        if not np.can_cast(array.dtype, kind, "same_kind"):
            raise base.UserError(f"action of type {array.dtype} must be {words}")
        if array.shape != shape:
            shown, wanted = (array.shape[1:], shape[1:]) if self.num == 1 else (array.shape, shape)
            raise base.UserError(f"action of shape {shown} must have shape {wanted}")
        if is_index and not ((array >= 0) & (array < space.n)).all():
            raise base.UserError(f"action {array.tolist()} must be from 0 to {space.n - 1}")

        with np.errstate(over="ignore"):  # what is beyond float32 becomes infinite
            array = array.astype(np.int32 if is_index else np.float32)
        if not np.isfinite(array).all():
            # NaN would make the simulation unstable, which counts as the policy's failure.
            place, value = next((i, x) for i, x in np.ndenumerate(array) if not np.isfinite(x))
            where = ", ".join(map(str, place[1:] if self.num == 1 else place))
            raise base.UserError(f"action[{where}] = {value} must be a finite number")
        return array

    def _mask(self, options: places.Options) -> np.ndarray | None:
        """Returns the rows that a reset concerns, None for all."""
        mask = options.get(places.MASK)
        if mask is None:
            return None
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num,):
            raise base.UserError(f"{places.MASK} = {mask!r} must be a bool array of {self.num}")
        if self._state is None:
            raise base.UserError(f"{places.MASK}: the other rows have begun no episode yet")
        return mask

    def __getstate__(self) -> dict[str, Any]:
        """Returns what a copy needs: no programs, and keys as plain numbers."""
        state = self._state
        if state is not None:
            state = state.replace(key=jax.random.key_data(state.key))
        return {**self.__dict__, "_state": jax.device_get(state)}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Takes over what `__getstate__` returned."""
        self.__dict__.update(saved)
        if self._state is not None:
            forks.check()
            state: EnvState = jax.device_put(self._state)
            self._state = state.replace(key=jax.random.wrap_key_data(state.key))


class _Programs(NamedTuple):
    """The compiled functions of N rows, for any N."""

    keys: jax.stages.Wrapped
    reset: jax.stages.Wrapped
    choose: jax.stages.Wrapped
    see: jax.stages.Wrapped
    step: jax.stages.Wrapped


class _OwnMaze(NamedTuple):
    """An environment whose `reset` begins episodes in maze 0 of its table, the maze as given."""

    env: PlacedEnvironment

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Draws a new episode; the key is consumed."""
        return self.env.reset(key, jnp.int32(0))

    def step(self, state: EnvState, action: Array) -> EnvState:
        """Advances one step."""
        return self.env.step(state, action)


@functools.lru_cache(maxsize=16)
def _programs(task: Task, mode: Mode) -> _Programs:
    """Returns the compiled programs of a task, shared by all environments of equal tasks."""
    forks.check()
    env = _OwnMaze(task.environment())

    def keys(seeds: UInt32[Array, " N"]) -> Key[Array, " N"]:
        return jax.vmap(jax.random.key)(seeds)

    def reset(keys: Key[Array, " N"], chosen: places.Places | None) -> EnvState:
        if chosen is None:
            return jax.vmap(env.reset)(keys)
        return jax.vmap(env.env.reset)(keys, chosen.maze, chosen.place)

    def step(state: EnvState, action: Array) -> tuple[EnvState, Outcomes]:
        following = jax.vmap(functools.partial(_STEPS[mode], env))(state, action)
        # In this mode the state keeps the flags of the episode that ended, though a new one began.
        is_stepped = jnp.ones_like(state.is_over) if mode == Mode.SAME_STEP else ~state.is_over
        return following, Outcomes(
            obs=jax.vmap(task.see)(following.obs),
            final=jax.vmap(task.see)(following.final_obs),
            reward=following.reward,
            terminated=following.terminated,
            truncated=following.truncated,
            metrics=following.metrics,
            is_stepped=is_stepped,
        )

    return _Programs(
        keys=jax.jit(keys),
        reset=jax.jit(reset, compiler_options=base.QUICK_COMPILE),
        choose=jax.jit(jax.vmap(tree.where)),
        see=jax.jit(jax.vmap(task.see)),
        step=jax.jit(step),
    )


def _same_step(env: _OwnMaze, state: EnvState, action: Array) -> EnvState:
    """Advances one step, and begins the next episode in the same step where one ends."""
    return wrappers.AutoReset(env).step(state, action)


def _next_step(env: _OwnMaze, state: EnvState, action: Array) -> EnvState:
    """Advances one step; where the episode is over already, begins the next one instead."""
    following = env.step(state, action)
    return batching.where_needed(state.is_over, env.reset, state.key, following)


def _no_reset(env: _OwnMaze, state: EnvState, action: Array) -> EnvState:
    """Advances one step; an episode that is over stays as it is."""
    return wrappers.rest_if_over(state, env.step(state, action))


_STEPS = {Mode.SAME_STEP: _same_step, Mode.NEXT_STEP: _next_step, Mode.DISABLED: _no_reset}


def _info(metrics: dict[str, Float[np.ndarray, " N"]]) -> Info:
    """Returns the metrics, and `is_success`, the name that Stable-Baselines3 reads."""
    return {**metrics, "is_success": metrics["success"] == 1.0}


def _arrays(values: Any) -> Any:
    """Copies a pytree to NumPy arrays, which unlike JAX's views may be written to."""
    return jax.tree.map(np.array, values)
