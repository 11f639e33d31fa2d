"""The physics model that both engines run: floor, robot, and a few wall boxes near the robot.

The number of boxes depends on the robot's reach alone, so a step costs the same in every maze.
"""

import mujoco
import numpy as np

from eihrl_jax import base
from eihrl_jax.robots import robot as robot_lib

BOTH, FLOOR_ONLY, WALLS_ONLY = 1, 2, 4
"""Values of `contype` of a robot's geoms, by what they collide with."""

PARKED_XY = (-1000.0, 1000.0)
"""Where a wall box waits while no wall is near, units."""

# Set in full: a robot's own default class must not leak into floor and walls.
# The floor has a margin, walls have none because MJX ignores it between boxes and round geoms.
_CONTACT = {
    "contype": 0,
    "condim": 3,
    "friction": [1.0, 0.5, 0.5],
    "solref": [0.02, 1.0],
    "solimp": [0.8, 0.8, 0.01, 0.5, 2.0],
    "density": 1000.0,
}


def build(robot: robot_lib.Robot, cell: float = base.CELL) -> mujoco.MjModel:
    """Compiles the scene of a robot.

    Floor and walls collide with the robot's geoms only. Walls are mocap boxes of one cell, as high
    as they are wide: against lower ones an immature ant lifts its torso to the upper edge.

    Args:
      robot: the robot; its MJCF holds neither floor nor walls.
      cell: side of a wall's box, units.

    Returns:
      The model; mocap bodies 0 to `robot.num_walls - 1` are the walls.

    Raises:
      base.UserError: the MJCF can't be read or compiled.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(robot.mjcf))
    except (ValueError, OSError) as error:
        raise _unusable(robot, error) from None

    spec.option.timestep = robot.physics_step
    is_in_fluid = spec.option.density > 0 or spec.option.viscosity > 0
    spec.option.integrator = (
        mujoco.mjtIntegrator.mjINT_EULER  # MJX has no implicit drag
        if is_in_fluid
        else mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    )
    # Few, but the same for both engines, of which MJX runs all of them in every step.
    spec.option.iterations = 4
    spec.option.ls_iterations = 8
    # A NaN must reach the environment's guard instead of teleporting the robot to the origin.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET

    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        margin=0.01,
        conaffinity=BOTH | FLOOR_ONLY,
        **_CONTACT,
    )
    half = cell / 2  # MuJoCo's sizes are half sides
    for i in range(robot.num_walls):
        body = spec.worldbody.add_body(name=f"wall_{i}", mocap=True, pos=[*PARKED_XY, half])
        body.add_geom(
            name=f"wall_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half, half, half],
            margin=0.0,
            conaffinity=BOTH | WALLS_ONLY,
            **_CONTACT,
        )

    try:
        model = spec.compile()
    except ValueError as error:
        raise _unusable(robot, error) from None
    _check(model, robot)
    return model


def _unusable(robot: robot_lib.Robot, error: Exception) -> base.UserError:
    """Says in one line what MuJoCo says in several."""
    return base.UserError(f"robot {robot.name!r}: {robot.mjcf}: {' '.join(str(error).split())}")


_ROOT_JOINTS = {
    "free": (mujoco.mjtJoint.mjJNT_FREE,),
    "planar": (*[mujoco.mjtJoint.mjJNT_SLIDE] * 2, mujoco.mjtJoint.mjJNT_HINGE),
    "slide": (mujoco.mjtJoint.mjJNT_SLIDE,) * 2,
}


def _check(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Checks what the package takes for granted; a user's own model may be otherwise."""
    what = f"robot {robot.name!r}: {robot.mjcf}"

    # The root: where qpos and qvel have position, heading and velocity of the torso.
    joints = _ROOT_JOINTS[robot.root]
    if tuple(model.jnt_type[: len(joints)]) != tuple(map(int, joints)):
        raise base.UserError(f"{what}: its first joints aren't those of root {robot.root!r}")
    axes = np.eye(3)[: len(joints)]
    if robot.root != "free" and (model.jnt_axis[: len(joints)] != axes).any():
        raise base.UserError(f"{what}: its first joints must slide along x and y, and turn about z")

    # All other joints have one number in qpos and one in qvel: free and ball joints have more.
    if (model.jnt_type[len(joints) :] < int(mujoco.mjtJoint.mjJNT_SLIDE)).any():
        raise base.UserError(f"{what}: besides the root's, its joints must be hinges and slides")

    # Controls are in [-1, 1] and all that there is to them: a state of an actuator would be lost.
    if robot.root == "slide" and model.actuator_trnid[:2, 0].tolist() != [0, 1]:
        raise base.UserError(f"{what}: its first two actuators must push along x and y")
    if not model.nu:
        raise base.UserError(f"{what}: it has no actuator")
    if not model.actuator_ctrllimited.all() or (model.actuator_ctrlrange != [-1.0, 1.0]).any():
        raise base.UserError(f"{what}: every actuator's ctrlrange must be -1 1")
    if model.na:
        raise base.UserError(f"{what}: its actuators must have no state, so no dyntype")

    if model.nmocap != robot.num_walls:
        raise base.UserError(f"{what}: it must have no mocap body of its own")
    _check_geoms(model, what)

    if not model.nkey:
        raise base.UserError(f"{what}: it has no keyframe, the posture in which episodes start")
    if robot.root == "free" and model.key_qpos[0, 4:6].any():
        raise base.UserError(f"{what}: its keyframe must be upright, turned about z alone")

    if robot.symmetry is not None:
        num_joints = model.njnt - len(joints)
        for name, size in (("joints", num_joints), ("controls", model.nu)):
            ordered = robot.symmetry.size(name)
            if ordered != size:
                raise base.UserError(f"{what}: symmetry orders {ordered} {name}, it has {size}")


def _check_geoms(model: mujoco.MjModel, what: str) -> None:
    """Checks that the robot's geoms meet floor and walls alone, see `docs/robots.md`."""
    # MuJoCo: geoms collide if the contype of one shares a bit with the conaffinity of the other.
    is_own = model.geom_conaffinity == 0
    for index in np.flatnonzero(~is_own).tolist():
        name = model.geom(index).name
        if name != "floor" and not name.startswith("wall_"):
            raise base.UserError(f"{what}: geom {name or index!r} must have conaffinity 0")

    if not np.isin(model.geom_contype[is_own], (0, BOTH, FLOOR_ONLY, WALLS_ONLY)).all():
        raise base.UserError(f"{what}: contype of a geom must be 0, 1, 2 or 4")
    if model.geom_margin[is_own].any():
        raise base.UserError(f"{what}: geoms must have no margin")
