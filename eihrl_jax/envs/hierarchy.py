"""Both levels together: a direction of the high level becomes k control steps (paper, Sec. 2).

A robot with physics and its low level is an environment whose actions are directions, like oracle
movement: so the same high level acts in both.
"""

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax.envs import low_obs, physics_maze, recovery, task
from eihrl_jax.robots import robot as robot_lib

LowPolicy: TypeAlias = Callable[[low_obs.LowObs, Key[Array, ""]], Float[Array, " nu"]]
"""From the low level's observation and a key to controls in [-1, 1]."""


def getting_up(
    walk: LowPolicy, stand: LowPolicy, robot: robot_lib.Robot, standing: float
) -> LowPolicy:
    """Returns a low level that walks, and stands up while the robot is down.

    Args:
      walk: acts while the robot is up.
      stand: acts while it is down, see `recovery.is_down`.
      robot: theirs, on a free root.
      standing: where its torso is when it stands, metres.
    """

    def policy(obs: low_obs.LowObs, key: Key[Array, ""]) -> Float[Array, " nu"]:
        height, quat = obs.proprioception[0], obs.proprioception[1:5]
        is_down = recovery.is_down(height, quat, robot, standing)
        return jnp.where(is_down, stand(obs, key), walk(obs, key))

    return policy


class Trace(struct.PyTreeNode):
    """The k control steps of a decision.

    Attributes:
      qpos: float32 [k, nq], the robot after each of them.
      is_fallen: bool [k], whether it lay on the ground after it.
      is_running: bool [k], whether the episode wasn't over before it; after the end `qpos` stays.
    """

    qpos: Float[Array, "k nq"]
    is_fallen: Bool[Array, " k"]
    is_running: Bool[Array, " k"]


@dataclasses.dataclass(frozen=True)
class Hierarchy:
    """An environment whose action is a direction, followed by a low level for k control steps.

    >>> import jax, eihrl_jax
    >>> robot, maze = eihrl_jax.load_robot("point"), eihrl_jax.load_maze("u")
    >>> low_policy = eihrl_jax.load_low("point", robot)
    >>> env = eihrl_jax.Hierarchy(eihrl_jax.PhysicsMaze.of_robot(robot, maze), low_policy)
    >>> state = jax.jit(env.reset)(jax.random.key(0))
    >>> state = jax.jit(env.step)(state, 0)  # a cell to the east
    >>> float(state.metrics["decisions"])
    1.0

    Attributes:
      env: the maze with the robot.
      low_policy: the low level.
    """

    env: physics_maze.PhysicsMaze
    low_policy: LowPolicy

    @property
    def table(self) -> task.MazeTable:
        """The mazes."""
        return self.env.table

    def reset(
        self,
        key: Key[Array, ""],
        maze: Int[Array, ""] | None = None,
        place: task.Place | None = None,
    ) -> physics_maze.EnvState:
        """Draws a new episode, in a given maze and place or in any; the key is consumed."""
        return self.env.reset(key, maze, place)

    def step(self, state: physics_maze.EnvState, action: Int[Array, ""]) -> physics_maze.EnvState:
        """Follows the direction `action` for one subgoal."""
        return self.trace(state, action)[0]

    def trace(
        self, state: physics_maze.EnvState, action: Int[Array, ""]
    ) -> tuple[physics_maze.EnvState, Trace]:
        """Follows the direction `action` for one subgoal; also returns the path."""
        next_key, low_key = jax.random.split(state.key)
        subgoal, body = self.env.begin(state, action)

        def advance(
            body: physics_maze.Body, key: Key[Array, ""]
        ) -> tuple[physics_maze.Body, Trace]:
            ctrl = self.low_policy(self.env.low_obs(subgoal, body), key)
            moved = self.env.control(subgoal, body, ctrl)
            step = Trace(
                qpos=moved.physics.qpos, is_fallen=moved.is_fallen, is_running=body.is_running
            )
            return moved, step

        # Always k steps; after an early end the robot rests, which costs nothing in the C engine.
        keys = jax.random.split(low_key, self.env.robot.steps_per_subgoal)
        body, trace = jax.lax.scan(advance, body, keys)
        # The whole path counts, so that goals along it are reached.
        state = self.env.end(state.replace(key=next_key), body, trace.qpos[:, :2])
        return state, trace
