"""Robots that have fallen: how upright one is, how one is thrown, and when it is down."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax.ops import rotations
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.robots import robot as robot_lib

_THROWN_JOINTS = 0.5
"""Half-width of the noise on a thrown robot's joints, radians."""

_THROWN_VELOCITY = 1.0
"""Standard deviation of a thrown robot's velocities, metres or radians per second."""

_UP = 0.5
"""Cosine of a tilt from which a robot hardly comes back by itself."""

_RAISED = 0.25
"""How far above its least healthy height a robot is no longer down, a share of the way up."""


def uprightness(
    qpos: Float[Array, " nq"], robot: robot_lib.Robot, height: float
) -> Float[Array, ""]:
    """Returns how upright a robot is: 1 as it stands, 0 upside down or on the ground.

    It is the product of the torso's height, as a share of the standing one, and of (1 + cos) / 2 of
    its tilt, so that turning over and rising both pay from anywhere.

    Args:
      qpos: the robot's.
      robot: its description; one without a free root is always upright.
      height: where the torso is when it stands, metres.
    """
    if robot.root != "free":
        return jnp.ones(())
    return jnp.clip(qpos[2] / height, 0.0, 1.0) * (1.0 + rotations.up(qpos[3:7])) / 2.0


def is_down(
    height: Float[Array, ""], quat: Float[Array, "4"], robot: robot_lib.Robot, standing: float
) -> Bool[Array, ""]:
    """Returns whether a robot lies on the ground, or nearly does: a walking one isn't down.

    Args:
      height: of its torso, metres.
      quat: of its torso.
      robot: its description.
      standing: where the torso is when it stands, metres.
    """
    if robot.healthy_z is None:
        return jnp.zeros((), bool)
    low = robot.healthy_z[0]
    return (height < low + _RAISED * (standing - low)) | (rotations.up(quat) < _UP)


def thrown(
    physics: engine_lib.PhysicsState, robot: robot_lib.Robot, key: Key[Array, ""]
) -> engine_lib.PhysicsState:
    """Returns a robot above its place in any orientation, its joints bent and its parts moving.

    Args:
      physics: where and how it stands; on a free root.
      robot: its description.
      key: consumed.
    """
    turn_key, joint_key, velocity_key = jax.random.split(key, 3)
    qpos, qvel = physics.qpos, physics.qvel

    # So high that no part is in the floor, however it is turned.
    turn = jax.random.normal(turn_key, (4,))
    bent = jax.random.uniform(joint_key, qpos[7:].shape, minval=-1.0, maxval=1.0)
    qpos = qpos.at[2].set(robot.reach).at[3:7].set(turn / jnp.linalg.norm(turn))
    qpos = qpos.at[7:].add(_THROWN_JOINTS * bent)
    moving = _THROWN_VELOCITY * jax.random.normal(velocity_key, qvel.shape)
    return engine_lib.reset(qpos, moving)
