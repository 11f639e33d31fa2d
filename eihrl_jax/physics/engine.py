"""The interface behind which both physics engines stand; environments know nothing else."""

from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import mujoco
from flax import struct
from jaxtyping import Array, Float

from eihrl_jax import base
from eihrl_jax.robots import robot as robot_lib


class PhysicsState(struct.PyTreeNode):
    """All that a simulation needs to go on. nq, nv: MuJoCo's sizes of the robot.

    Attributes:
      qpos: float32 [nq], generalised positions; units, radians, unit quaternion.
      qvel: float32 [nv], generalised velocities per second.
      qacc_warmstart: float32 [nv], where the constraint solver starts from.
    """

    qpos: Float[Array, " nq"]
    qvel: Float[Array, " nv"]
    qacc_warmstart: Float[Array, " nv"]

    @property
    def proprioception(self) -> Float[Array, " P"]:
        """What the robot feels of itself: qpos without x and y, then qvel."""
        return jnp.concatenate([self.qpos[2:], self.qvel])


@runtime_checkable
class Engine(Protocol):
    """Steps one robot near walls; usable inside `jit`, `vmap` and `scan`.

    Attributes:
      robot: the robot that it drives.
      model: the compiled scene, see `scene.build`.
    """

    robot: robot_lib.Robot
    model: mujoco.MjModel

    def step(
        self,
        state: PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
    ) -> PhysicsState:
        """Advances one control step.

        Args:
          state: where the robot is.
          ctrl: actuator controls in [-1, 1], held for the whole step; values outside are clipped.
            A robot whose controls are nan rests as it is, which the C engine does for nothing: so
            an episode that has ended is put aside.
          walls_xy: centres of the wall cells near the robot, units, see `walls.nearby`.

        Returns:
          The state `robot.control_step` seconds later.
        """
        ...


def reset(qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]) -> PhysicsState:
    """Returns the state of a robot put at `qpos` with velocity `qvel`; costs no physics."""
    return PhysicsState(
        qpos=qpos.astype(jnp.float32),
        qvel=qvel.astype(jnp.float32),
        qacc_warmstart=jnp.zeros_like(qvel, jnp.float32),
    )


def make(robot: robot_lib.Robot, name: str = "mujoco", cell: float = base.CELL) -> Engine:
    """Returns an engine for a robot.

    Args:
      robot: the robot to drive.
      name: "mujoco" for the C engine on the processor's cores, "mjx" for JAX.
      cell: side of a wall's box, units.

    Raises:
      base.UserError: the engine is unknown.
    """
    if name == "mujoco":
        from eihrl_jax.physics import mujoco_engine

        return mujoco_engine.MujocoEngine(robot, cell)
    if name == "mjx":
        from eihrl_jax.physics import mjx_engine

        return mjx_engine.MjxEngine(robot, cell)
    raise base.UserError(f"engine {name!r} is unknown; choose one of {', '.join(base.ENGINES)}")
