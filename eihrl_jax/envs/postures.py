"""Postures that a robot takes while it walks, and their silhouettes for the high level's pictures.

The low level's trainer records a bank of them (paper, Sec. 3.2), so that oracle movement can show
what the high level will see of the robot with physics.
"""

import pathlib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float

from eihrl_jax import base
from eihrl_jax.envs import raster
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.storage import archives

_SPREAD = 0.4
"""How far synthetic joints go from the standing posture to their limits."""

_TILT = 0.1
"""Standard deviation of a synthetic posture's roll and pitch, radians."""

_CHUNK = 64
"""Silhouettes that are drawn at once; bounds memory."""


class PostureBank(struct.PyTreeNode):
    """N postures of one robot.

    Attributes:
      qpos: float32 [N, nq], MuJoCo's generalised positions, torso at x = y = 0.
    """

    qpos: Float[Array, "N nq"]


def synthetic(robot: robot_lib.Robot, num: int = 512, seed: int = 0) -> PostureBank:
    """Makes up postures for a robot without a low level.

    Joints are spread around the keyframe `stand`, the heading is any, a free root is tilted a
    little, and its lowest part touches the floor.

    Args:
      robot: the robot; its model's first two positions are x and y.
      num: number of postures.
      seed: the same seed gives the same postures.
    """
    model = scene.build(robot)
    rng = np.random.default_rng(seed)
    stand = model.key_qpos[0]
    qpos = np.repeat(stand[None], num, 0)

    for joint in range(model.njnt):
        address = model.jnt_qposadr[joint]
        kind = mujoco.mjtJoint(model.jnt_type[joint])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            qpos[:, address + 3 : address + 7] = _random_headings(rng, num)
        elif kind == mujoco.mjtJoint.mjJNT_HINGE:
            # Any angle for a joint without limits, the root's yaw above all.
            is_limited = model.jnt_limited[joint]
            low, high = model.jnt_range[joint] if is_limited else (-np.pi, np.pi)
            spread = _SPREAD if is_limited else 1.0
            drawn = rng.uniform(low, high, num)
            qpos[:, address] += spread * (drawn - stand[address])
    qpos[:, :2] = 0.0

    # Down to the floor, or up from below it.
    if robot.root == "free":
        to_capsules = jax.jit(jax.vmap(kinematics.capsules(model)))
        start, end, radius = to_capsules(jnp.asarray(qpos, jnp.float32))
        lowest = np.asarray(jnp.minimum(start[..., 2], end[..., 2]) - radius).min(1)
        qpos[:, 2] -= lowest
    return PostureBank(qpos=jnp.asarray(qpos, jnp.float32))


def save(bank: PostureBank, path: pathlib.Path, robot: robot_lib.Robot) -> None:
    """Writes a bank, see `archives.write`."""
    archives.write(path, {"robot": np.array(robot.name), "qpos": np.asarray(bank.qpos)})


def load(path: pathlib.Path, robot: robot_lib.Robot) -> PostureBank:
    """Reads a bank that `save` wrote; nothing in the file is executed.

    Raises:
      base.UserError: the file is missing, damaged, or another robot's.
    """
    try:
        arrays = archives.read(path)
        name, qpos = str(arrays["robot"]), arrays["qpos"]
    except OSError as error:
        raise base.UserError(f"posture bank {path} can't be read: {error.strerror}") from None
    except KeyError as error:
        raise base.UserError(f"posture bank {path} lacks {error}") from None
    except base.UserError as error:
        raise base.UserError(f"posture bank {error}") from None

    if name != robot.name:
        raise base.UserError(f"posture bank {path} is of robot {name!r}, expected {robot.name!r}")
    num_positions = scene.build(robot).nq
    if qpos.ndim != 2 or qpos.shape[1] != num_positions or not len(qpos):
        raise base.UserError(
            f"posture bank {path} has shape {qpos.shape}, expected (N, {num_positions}) with N > 0"
        )
    if qpos.dtype != np.float32 or not np.isfinite(qpos).all():
        raise base.UserError(f"posture bank {path} must hold finite float32 numbers")
    return PostureBank(qpos=jnp.asarray(qpos).at[:, :2].set(0.0))


def for_robot(robot: robot_lib.Robot) -> PostureBank:
    """Returns the bank that the package ships for a robot, else a synthetic one.

    Raises:
      base.UserError: the shipped bank is damaged.
    """
    shipped = base.PRETRAINED / robot.name / "postures.npz"
    return load(shipped, robot) if shipped.exists() else synthetic(robot)


def footprints(
    robot: robot_lib.Robot, bank: PostureBank, view: raster.View
) -> Bool[Array, "N P P"]:
    """Draws the silhouette of every posture, seen from above with the torso in the middle.

    Args:
      robot: whose postures they are.
      bank: N postures, drawn with the heading they were recorded with.
      view: extent and resolution of the pictures.
    """
    to_capsules = kinematics.capsules(scene.build(robot), robot.units_per_metre)

    def draw(qpos: Float[Array, " nq"]) -> Bool[Array, "P P"]:
        return raster.footprint(to_capsules(qpos), qpos[:2], view)

    return jax.jit(lambda rows: jax.lax.map(draw, rows, batch_size=_CHUNK))(bank.qpos)


def _random_headings(rng: np.random.Generator, num: int) -> np.ndarray:
    """Returns quaternions [num, 4] of any yaw after a small roll and pitch."""
    yaw = rng.uniform(-np.pi, np.pi, num)
    tilt = rng.normal(0.0, _TILT, (num, 2))
    quats = np.zeros((num, 4))
    for quat, angle, (roll, pitch) in zip(quats, yaw, tilt, strict=True):
        mujoco.mju_euler2Quat(quat, np.array([angle, pitch, roll]), "zyx")
    return quats
