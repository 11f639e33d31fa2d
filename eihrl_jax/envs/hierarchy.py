"""The two levels put together: a direction from above becomes k steps below (paper, Sec. 2).

With a low level in it, a walking robot is an environment of decisions like the oracle's: whatever
chooses directions there chooses them here.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base

LowPolicy = Callable[[Any, Key[Array, ""]], Float[Array, " nu"]]
"""From the low level's observation and a key to controls in [-1, 1]."""


@runtime_checkable
class Walker(Protocol):
    """What is asked of an environment with a walking robot, see `envs.physics_maze.PhysicsMaze`."""

    robot: Any
    table: Any

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> base.EnvState:
        """Draws a new episode."""
        ...

    def begin(self, state: base.EnvState, direction: Int[Array, ""]) -> tuple[Any, Any]:
        """Begins a decision; returns what stays, and the robot."""
        ...

    def low_obs(self, subgoal: Any, body: Any) -> Any:
        """Returns the low level's observation."""
        ...

    def control(self, subgoal: Any, body: Any, ctrl: Float[Array, " nu"]) -> Any:
        """Advances the robot one control step."""
        ...

    def end(self, state: base.EnvState, body: Any, path_xy: Float[Array, "k 2"]) -> base.EnvState:
        """Ends a decision."""
        ...


class Trace(struct.PyTreeNode):
    """The k control steps of a decision.

    Attributes:
      qpos: float32 [k, nq], the robot after each of them.
      is_fallen: bool [k], whether it lay on the ground after it.
      is_running: bool [k], whether the episode went on through it; at rest `qpos` stays the same.
    """

    qpos: Float[Array, "k nq"]
    is_fallen: Bool[Array, " k"]
    is_running: Bool[Array, " k"]


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """An environment whose action is a direction, followed by a low level for k control steps.

    Attributes:
      env: the maze with the robot.
      low_policy: the low level.
    """

    env: Walker
    low_policy: LowPolicy

    @property
    def table(self) -> Any:
        """The mazes, see `envs.task.MazeTable`."""
        return self.env.table

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> base.EnvState:
        """Draws a new episode, in a given maze or in any; the key is consumed."""
        return self.env.reset(key, maze)

    def step(self, state: base.EnvState, action: Int[Array, ""]) -> base.EnvState:
        """Follows the direction `action` for one subgoal."""
        return self.trace(state, action)[0]

    def trace(self, state: base.EnvState, action: Int[Array, ""]) -> tuple[base.EnvState, Trace]:
        """Does what `step` does, and also returns the way there."""
        next_key, low_key = jax.random.split(state.key)
        subgoal, body = self.env.begin(state, action)

        def advance(body: Any, key: Key[Array, ""]) -> tuple[Any, Trace]:
            is_running = body.is_running
            ctrl = self.low_policy(self.env.low_obs(subgoal, body), key)
            body = self.env.control(subgoal, body, ctrl)
            step = Trace(qpos=body.physics.qpos, is_fallen=body.is_fallen, is_running=is_running)
            return body, step

        keys = jax.random.split(low_key, self.env.robot.steps_per_subgoal)
        body, trace = jax.lax.scan(advance, body, keys)
        state = self.env.end(state.replace(key=next_key), body, trace.qpos[:, :2])
        return state, trace
