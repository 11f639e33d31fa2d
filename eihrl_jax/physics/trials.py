"""Trials of a robot in simulation: does it behave as its description says?"""

import mujoco
import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.physics import controls, posture, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.robots import symmetry as symmetry_lib

_NUM_STEPS = 100
"""Control steps at full power by which the greatest speed is measured."""

_HELD = 10
"""Control steps for which each of them keeps its direction."""

_NUM_COMPARED = 5
"""Control steps after which both ways to rename are compared; longer ones diverge by rounding."""

_SYMMETRIC = 0.02
"""Radians or metres by which they may differ, since a contact's friction has directions."""

_DEEP = 0.1
"""Share of the reach by which the start posture may be in the floor."""

_WILD = 1e3
"""Velocity beyond which a simulation isn't stable."""

AT_REST = 2.0
"""Seconds without control in which a robot may show that it stands."""

_TOLERANCE = 1.02
"""How much farther a part may come than the description says."""

_UNSTABLE = "its simulation breaks down at full power: take a smaller physics_step"


def check(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Checks the numbers of a description that ensure that walls hold the robot.

    Args:
      model: its scene.
      robot: the description.

    Raises:
      base.UserError: parts of it are farther away, or it is faster, than the description says, or
        its simulation breaks down.
    """
    for fault in _of_walls(model, robot):
        raise base.UserError(f"robot {robot.name!r}: {fault}")


def faults(model: mujoco.MjModel, robot: robot_lib.Robot) -> list[str]:
    """Returns all faults of a description that a simulation shows, one line each.

    Args:
      model: its scene.
      robot: the description.
    """
    found = _of_walls(model, robot)
    start = model.key_qpos[0]

    limited = np.flatnonzero(model.jnt_limited)
    positions, ranges = start[model.jnt_qposadr[limited]], model.jnt_range[limited]
    is_out = (positions < ranges[:, 0] - 1e-6) | (positions > ranges[:, 1] + 1e-6)
    if is_out.any():
        names = ", ".join(model.joint(i).name or str(i) for i in limited[is_out])
        found.append(f"the start posture is outside of the range of joints {names}")

    if robot.healthy_z is not None and not robot.healthy_z[0] <= start[2] <= robot.healthy_z[1]:
        found.append(
            f"the start posture's height {start[2]:.2f} is outside of healthy_z = {robot.healthy_z}"
        )
    if robot.root == "free" and (depth := -posture.lowest(model, start)) > _DEEP * robot.reach:
        found.append(f"in its start posture it is {depth:.2f} m deep in the floor")
    if _UNSTABLE not in found and not is_stable(model, robot):
        found.append(_UNSTABLE)
    if (error := symmetry_error(model, robot)) > _SYMMETRIC:
        found.append(f"its symmetry isn't one of the physics: it is wrong by {error:.2f}")
    return found


def _of_walls(model: mujoco.MjModel, robot: robot_lib.Robot) -> list[str]:
    """Returns reasons why walls wouldn't hold a robot, one line each."""
    found = []
    reach = posture.reach(model, robot)
    if reach > _TOLERANCE * robot.reach:
        remedy = f"reach must be {reach:.2f}"
        if reach > robot.cell:
            remedy = f"it needs a cell of more than {reach:.2f}"
        found.append(
            f"reach = {robot.reach}, but parts come {reach:.2f} m far from its torso: {remedy}"
        )

    speed = top_speed(model, robot)
    limit = robot.max_travel / robot.units_per_metre / robot.control_step
    if not np.isfinite(speed):
        found.append(_UNSTABLE)
    elif speed * robot.physics_step > robot.body_radius:
        found.append(
            f"at full power it moves {speed * robot.physics_step:.2f} m in a physics step, farther "
            f"than its body_radius of {robot.body_radius}: take a smaller physics_step"
        )
    elif speed > limit:
        found.append(
            f"at full power it moves at {speed:.1f} m/s, and walls hold up to {limit:.1f}: say "
            f"max_speed = {1.05 * speed:.1f}, or take fewer num_substeps"
        )
    return found


def size(model: mujoco.MjModel) -> str:
    """Returns in words how much there is of a robot: its joints besides a free root, and so on."""
    num_joints = int((model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).sum())
    mass = model.body_subtreemass[model.jnt_bodyid[0]]
    return f"{num_joints} joints, {model.nu} actuators, {mass:.1f} kg"


def seconds_upright(model: mujoco.MjModel, robot: robot_lib.Robot) -> float:
    """Returns how long it stays in its healthy heights without control, at most `AT_REST`."""
    if robot.healthy_z is None:
        return AT_REST
    data, low_high = _data(model, robot), robot.healthy_z
    data.ctrl[:] = controls.of(model, robot).rest
    for step in range(round(AT_REST / robot.control_step)):
        mujoco.mj_step(model, data, robot.num_substeps)
        if not low_high[0] <= data.qpos[2] <= low_high[1]:
            return step * robot.control_step
    return AT_REST


def is_stable(model: mujoco.MjModel, robot: robot_lib.Robot, seed: int = 0) -> bool:
    """Returns whether the simulation stays stable with random controls of -1 and 1."""
    rng, data, taken = np.random.default_rng(seed), _data(model, robot), controls.of(model, robot)
    for _ in range(_NUM_STEPS):
        data.ctrl[:] = taken.of(rng.choice(np.array([-1.0, 1.0], np.float32), model.nu))
        mujoco.mj_step(model, data, robot.num_substeps)
        if not (np.isfinite(data.qpos).all() and np.abs(data.qvel).max() < _WILD):
            return False
    return True


def symmetry_error(model: mujoco.MjModel, robot: robot_lib.Robot, seed: int = 0) -> float:
    """Returns by how much renaming and stepping fail to commute, in the model's positions.

    Args:
      model: the robot's scene.
      robot: the description.
      seed: of joints and controls.
    """
    symmetry = robot.symmetry
    if symmetry is None:
        return 0.0
    rng, taken = np.random.default_rng(seed), controls.of(model, robot)
    start = _data(model, robot)
    num_root = {"free": 7, "planar": 3, "slide": 2}[robot.root]
    start.qpos[num_root:] += 0.1 * rng.uniform(-1.0, 1.0, model.nq - num_root)
    ctrls = rng.uniform(-1.0, 1.0, (_NUM_COMPARED, model.nu)).astype(np.float32)

    def run(variant: int, *, first: bool) -> np.ndarray:
        """Renames before or after stepping."""
        order, signs = (table[variant] for table in symmetry.control_tables())
        data = _data(model, robot)
        data.qpos[:] = renamed(start.qpos, robot.root, symmetry, variant) if first else start.qpos
        for ctrl in ctrls:
            data.ctrl[:] = taken.of(signs * ctrl[order] if first else ctrl)
            mujoco.mj_step(model, data, robot.num_substeps)
        return data.qpos.copy() if first else renamed(data.qpos, robot.root, symmetry, variant)

    variants = range(len(symmetry.control_tables()[0]))
    return max(float(np.abs(run(v, first=True) - run(v, first=False)).max()) for v in variants)


def renamed(
    qpos: Float[np.ndarray, " nq"],
    root: robot_lib.Root,
    symmetry: symmetry_lib.Symmetry,
    variant: int,
) -> Float[np.ndarray, " nq"]:
    """Returns qpos with the body's axes turned and mirrored at y = 0, see `symmetry.tables`."""
    turns, is_mirrored = variant % symmetry.num_turns, variant >= symmetry.num_turns
    angle = 2 * np.pi * turns / symmetry.num_turns
    order, signs = (table[variant] for table in symmetry.joint_tables())
    image = qpos.copy()

    num_root = 2
    if root == "free":
        turn, quat, num_root = np.zeros(4), np.zeros(4), 7
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), angle)
        mujoco.mju_mulQuat(quat, qpos[3:7], turn)
        quat *= [1, -1, 1, -1] if is_mirrored else 1
        image[3:7] = quat * np.sign(quat[0] or 1.0)  # either sign is the same orientation
    elif root == "planar":
        num_root, yaw = 3, qpos[2] + angle
        image[2] = -yaw if is_mirrored else yaw
    if is_mirrored:
        image[1] *= -1
    image[num_root:] = signs * qpos[num_root:][order]
    return image


def _data(model: mujoco.MjModel, robot: robot_lib.Robot) -> mujoco.MjData:
    """Returns the robot in its start posture, walls far away."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    data.mocap_pos[:] = (*scene.PARKED_XY, robot.cell / 2)
    return data


def top_speed(model: mujoco.MjModel, robot: robot_lib.Robot, seed: int = 0) -> float:
    """Returns the torso's greatest mean speed along an axis in a control step at full power, m/s.

    It is infinite where the simulation breaks down.

    Args:
      model: the robot's scene; walls are far away.
      robot: the description.
      seed: of the controls, each of which is -1 or 1 for a while.
    """
    rng, data, taken = np.random.default_rng(seed), _data(model, robot), controls.of(model, robot)
    greatest = 0.0

    # First all of them forward: those of a cart that steers would turn it on the spot at random.
    ctrl = np.ones(model.nu, np.float32)
    for step in range(_NUM_STEPS):
        before = data.qpos[:2].copy()
        data.ctrl[:] = taken.of(ctrl)
        mujoco.mj_step(model, data, robot.num_substeps)
        path = np.abs(data.qpos[:2] - before).max()
        if not np.isfinite(path):
            return np.inf
        greatest = max(greatest, float(path))
        if step % _HELD == _HELD - 1 and step >= _NUM_STEPS // 2:
            ctrl = rng.choice(np.array([-1.0, 1.0], np.float32), model.nu)
    return greatest / robot.control_step
