"""The interface of both physics engines; environments use nothing else."""

from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import mujoco
from flax import struct
from jaxtyping import Array, Bool, Float

from eihrl_jax.robots import robot as robot_lib


class PhysicsState(struct.PyTreeNode):
    """All that a simulation needs to go on. nq, nv: MuJoCo's sizes of the robot.

    Attributes:
      qpos: float32 [nq], generalised positions: x and y in units of mazes, all else as in the
        model, in metres, radians, unit quaternion.
      qvel: float32 [nv], the model's generalised velocities, metres or radians per second.
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
        is_running: Bool[Array, ""] | bool = True,
    ) -> PhysicsState:
        """Advances one control step.

        Args:
          state: where the robot is.
          ctrl: actuator controls in [-1, 1], held for the whole step; values outside are clipped,
            of a robot with a `recovery_range` at its `recovery_scale`.
          walls_xy: centres of the wall cells near the robot, units, see `walls.nearby`.
          is_running: whether the robot moves at all. One that doesn't stays as it is, which costs
            the C engine nothing: so an episode that has ended is put aside.

        Returns:
          The state `robot.control_step` seconds later; its positions are nan where the simulation
          broke down, as it does with controls that are nan.
        """
        ...


def reset(qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]) -> PhysicsState:
    """Returns the state of a robot put at `qpos` with velocity `qvel`; costs no physics."""
    return PhysicsState(
        qpos=qpos.astype(jnp.float32),
        qvel=qvel.astype(jnp.float32),
        qacc_warmstart=jnp.zeros_like(qvel, jnp.float32),
    )
