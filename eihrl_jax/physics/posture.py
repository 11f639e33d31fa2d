"""The posture in which a robot's episodes start, and how far its parts reach in any posture."""

import mujoco
import numpy as np
from jaxtyping import Float

from eihrl_jax.physics import kinematics
from eihrl_jax.robots import robot as robot_lib

CLEARANCE = 0.1
"""Share of a cell between the floor and a robot that slides in the plane."""

_NUM_DRAWN = 200
"""Postures by which the reach is measured."""


def set_start(model: mujoco.MjModel, robot: robot_lib.Robot, has_keyframe: bool) -> None:
    """Makes the model's keyframe the start posture, and leaves positions x and y at the origin.

    It is that of the description or the file's keyframe; else the model's zero posture, with the
    joints moved into their ranges and a free root put down on the floor.

    Args:
      model: compiled, with one keyframe; changed in place.
      robot: the description.
      has_keyframe: whether the keyframe is one of the file's.

    Raises:
      ValueError: the description's posture has another number of positions; in one line.
    """
    start = model.key_qpos[0]
    if robot.start is not None:
        if len(robot.start) != model.nq:
            raise ValueError(f"start has {len(robot.start)} numbers, its qpos has {model.nq}")
        start[:] = robot.start
    elif not has_keyframe:
        start[:] = model.qpos0
        for joint in np.flatnonzero(model.jnt_limited):
            address = model.jnt_qposadr[joint]
            start[address] = np.clip(start[address], *model.jnt_range[joint])
        if robot.root == "free":
            start[2] -= lowest(model, start)
    start[:2] = 0.0


def lift(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Lifts a robot that slides in the plane off the floor, so that it meets walls from the side.

    Args:
      model: compiled; changed in place.
      robot: the description.
    """
    missing = CLEARANCE * robot.cell - lowest(model, model.key_qpos[0])
    model.body_pos[model.jnt_bodyid[0], 2] += max(missing, 0.0)


def standing_height(model: mujoco.MjModel) -> float:
    """Returns the torso's height in the start posture, metres; without a free root any number."""
    return float(model.key_qpos[0, 2]) if model.nq > 2 else 0.0


def lowest(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> float:
    """Returns the height of a robot's lowest part that collides, in metres."""
    ends, radius = _solid_parts(model, qpos)
    return float((ends[..., 2] - radius).min())


def farthest(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> float:
    """Returns how far a part that collides is from the torso's x and y at most, in metres."""
    ends, radius = _solid_parts(model, qpos)
    return float((np.linalg.norm(ends[..., :2] - qpos[:2], axis=-1) + radius).max())


def sides(model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]) -> Float[np.ndarray, "2"]:
    """Returns the sides along x and y of the rectangle around a robot's colliding parts, metres."""
    ends, radius = _solid_parts(model, qpos)
    outer = np.concatenate([ends[..., :2] - radius[:, None], ends[..., :2] + radius[:, None]])
    return np.ptp(outer.reshape(-1, 2), axis=0)


def reach(model: mujoco.MjModel, robot: robot_lib.Robot, seed: int = 0) -> float:
    """Returns the greatest of `farthest` over random postures of joints and root, in metres."""
    rng = np.random.default_rng(seed)
    greatest = farthest(model, model.key_qpos[0])
    for _ in range(_NUM_DRAWN):
        qpos = model.key_qpos[0].copy()
        for joint in np.flatnonzero(model.jnt_limited):
            low, high = model.jnt_range[joint]
            # Beyond the range and back into it: limits are where robots are longest.
            drawn = rng.uniform(2 * low - high, 2 * high - low)
            qpos[model.jnt_qposadr[joint]] = np.clip(drawn, low, high)
        if robot.root == "free":
            qpos[3:7] = rng.normal(size=4)
        greatest = max(greatest, farthest(model, qpos))
    return greatest


def _solid_parts(
    model: mujoco.MjModel, qpos: Float[np.ndarray, " nq"]
) -> tuple[Float[np.ndarray, "2 G 3"], Float[np.ndarray, " G"]]:
    """Returns both ends and the radii of the robot's colliding geoms as capsules."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)

    local = kinematics.local_capsules(model)
    is_solid = model.geom_contype[local.geom] != 0
    body = model.geom_bodyid[local.geom]
    rotation, position = data.xmat[body].reshape(-1, 3, 3), data.xpos[body]
    ends = np.stack(
        [position + np.einsum("gij,gj->gi", rotation, end) for end in (local.start, local.end)]
    )
    return ends[:, is_solid], local.radius[is_solid]
