"""The physics model that both engines run: floor, robot, and a few wall boxes near the robot.

The number of boxes depends on the robot's reach alone, so a step costs the same in every maze.
"""

import hashlib
import warnings

import mujoco
import numpy as np

from eihrl_jax import base
from eihrl_jax.physics import controls, posture, stock
from eihrl_jax.physics.stock import BOTH, FLOOR_ONLY, WALLS_ONLY
from eihrl_jax.robots import mjcf
from eihrl_jax.robots import robot as robot_lib

FLOOR = "scene: floor"
"""Name of the floor's geom; like those of the walls it is none that a robot's file would have."""

_UPRIGHT = 0.02
"""Greatest x or y of a start posture's unit quaternion."""

PARKED_XY = (-1000.0, 1000.0)
"""Where a wall box waits while no wall is near, units."""

MAX_CONTACTS = 12
"""Contacts of each dimension that get forces in MJX, the deepest ones: the C engine takes all.

Ants, humanoids and Go1s that tumble in a corner have 10 at most in the C engine.
"""

_RESET_BITS = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_LIMIT,
    mujoco.mjtDisableBit.mjDSBL_ACTUATION,
    mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL,
    mujoco.mjtDisableBit.mjDSBL_FILTERPARENT,
)
"""Flags of a file that would switch off what the scene is for."""

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


_MEANING = (
    *("jnt_type", "jnt_axis", "jnt_range", "dof_damping", "dof_armature", "body_mass", "body_pos"),
    *("body_quat", "geom_type", "geom_size", "geom_pos", "geom_contype", "actuator_gear"),
    *("actuator_gainprm", "actuator_biasprm"),
)
"""What of a compiled model a low level has learned to live with, besides its controls and start."""


def fingerprint(model: mujoco.MjModel, robot: robot_lib.Robot, *, full_range: bool = False) -> str:
    """Returns a text that changes with a robot's model and with the times of its description.

    Args:
      model: its scene.
      robot: its description.
      full_range: whether the low level moves servos as far as a robot that gets up may.
    """
    taken = controls.of(model, robot)
    ranges = np.stack([taken.low, taken.high], axis=1)
    arrays = *(getattr(model, name) for name in _MEANING), ranges, model.key_qpos, model.key_ctrl
    # To four digits, in which versions of MuJoCo agree.
    numbers = [f"{x:.3e}" for array in arrays for x in np.ravel(array) + 0.0]
    times = robot.physics_step, robot.num_substeps, robot.steps_per_subgoal
    told = (numbers, times, taken.limit) if full_range else (numbers, times)
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]


def _silence() -> None:
    """Drops what MuJoCo warns of while it steps: environments say what has broken down.

    It would write it onto the terminal, and into a file MUJOCO_LOG.TXT wherever the user is.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: None)


def wall_name(index: int) -> str:
    """Returns the name of a wall's body and of its geom."""
    return f"scene: wall {index}"


def build(robot: robot_lib.Robot, cell: float | None = None) -> mujoco.MjModel:
    """Compiles the scene of a robot, whatever else stands in the robot's file.

    Floor and walls collide with the robot's geoms only. Walls are mocap boxes of one cell, as high
    as they are wide: against lower ones an immature ant lifts its torso to the upper edge.

    Args:
      robot: the robot; of its file the robot alone is used, see `stock`.
      cell: side of a wall's box, metres; None: the robot's cell.

    Returns:
      The model; mocap bodies 0 to `robot.num_walls - 1` are the walls, keyframe 0 is the posture in
      which episodes start, and `controls.of` says what its actuators take.

    Raises:
      base.UserError: the MJCF can't be read or compiled, or the description doesn't fit it.
    """
    _silence()
    try:
        spec = mjcf.load(robot.mjcf)
        adapted = stock.adapt(spec, robot)
        _set_options(spec, robot)
        _add_surroundings(spec, robot.cell if cell is None else cell, robot.num_walls)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is deprecated in a file of somebody else's
            model = spec.compile()

        if adapted.mass is not None:
            stock.set_mass(model, adapted.mass)
        _check_numbers(model)
        posture.set_start(model, robot, adapted.has_keyframe)
        if robot.root != "free" and not adapted.is_ours:
            posture.lift(model, robot)
        _check(model, robot)
        controls.fit(model, robot)
    except (ValueError, OSError) as error:
        raise _unusable(robot, error) from None
    return model


def _set_options(spec: mujoco.MjSpec, robot: robot_lib.Robot) -> None:
    """Sets what both engines have in common; gravity and fluids are the file's."""
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
    for bit in _RESET_BITS:
        spec.option.disableflags &= ~int(bit)
    spec.option.enableflags = 0


def _add_surroundings(spec: mujoco.MjSpec, cell: float, num_walls: int) -> None:
    """Adds the floor, and wall boxes with sides of `cell` metres."""
    spec.worldbody.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        margin=0.01,
        conaffinity=BOTH | FLOOR_ONLY,
        **_CONTACT,
    )
    # MJX's own name; a file may hold one already.
    limit = spec.numeric("max_contact_points") or spec.add_numeric(name="max_contact_points")
    limit.size, limit.data = 1, [MAX_CONTACTS]

    half = cell / 2  # MuJoCo's sizes are half sides
    for i in range(num_walls):
        body = spec.worldbody.add_body(name=wall_name(i), mocap=True, pos=[*PARKED_XY, half])
        body.add_geom(
            name=wall_name(i),
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[half, half, half],
            margin=0.0,
            conaffinity=BOTH | WALLS_ONLY,
            **_CONTACT,
        )


def _unusable(robot: robot_lib.Robot, error: Exception) -> base.UserError:
    """Shortens MuJoCo's error message to one line."""
    return base.UserError(f"robot {robot.name!r}: {robot.mjcf}: {' '.join(str(error).split())}")


_ROOT_JOINTS = {
    "free": (mujoco.mjtJoint.mjJNT_FREE,),
    "planar": (*[mujoco.mjtJoint.mjJNT_SLIDE] * 2, mujoco.mjtJoint.mjJNT_HINGE),
    "slide": (mujoco.mjtJoint.mjJNT_SLIDE,) * 2,
}


def _check_numbers(model: mujoco.MjModel) -> None:
    """Checks that the file's numbers are some, which MuJoCo doesn't.

    Raises:
      ValueError: one isn't finite; in one line.
    """
    for what in ("jnt_range", "actuator_ctrlrange", "body_mass", "geom_size", "qpos0"):
        if not np.isfinite(getattr(model, what)).all():
            raise ValueError(f"{what.replace('_', ' ')} must be finite")


def _check(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Checks what the package takes for granted; a user's own model may be otherwise.

    Raises:
      ValueError: it is otherwise; in one line.
    """
    # The root: where qpos and qvel have position, heading and velocity of the torso.
    joints = _ROOT_JOINTS[robot.root]
    if tuple(model.jnt_type[: len(joints)]) != tuple(map(int, joints)):
        raise ValueError(f"its first joints aren't those of root {robot.root!r}")
    axes = np.eye(3)[: len(joints)]
    if robot.root != "free" and (model.jnt_axis[: len(joints)] != axes).any():
        raise ValueError("its first joints must slide along x and y, and turn about z")
    _check_torso(model, robot)

    # All other joints have one number in qpos and one in qvel: free and ball joints have more.
    if (model.jnt_type[len(joints) :] < int(mujoco.mjtJoint.mjJNT_SLIDE)).any():
        raise ValueError("besides the root's, its joints must be hinges and slides")

    if not model.nu:
        raise ValueError("it has no actuator")
    if robot.root == "slide" and model.actuator_trnid[:2, 0].tolist() != [0, 1]:
        raise ValueError("its first two actuators must push along x and y")
    if model.nmocap != robot.num_walls:
        raise ValueError("it must have no mocap body of its own")
    if robot.root == "free" and np.abs(model.key_qpos[0, 4:6]).max() > _UPRIGHT:
        raise ValueError(
            "its start posture must be upright, turned about z alone: name another keyframe, or "
            "give start in the description"
        )

    if robot.symmetry is not None:
        num_joints = model.njnt - len(joints)
        for name, size in (("joints", num_joints), ("controls", model.nu)):
            ordered = robot.symmetry.size(name)
            if ordered != size:
                raise ValueError(f"symmetry orders {ordered} {name}, it has {size}")


def _check_torso(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Checks that the torso stands where qpos says, which a turned or shifted body needn't.

    Raises:
      ValueError: it doesn't; in one line.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    data.qpos[:2] = asked = np.array([1.3, -0.7])
    if robot.root == "planar":
        data.qpos[2] = 0.9  # a torso that turns about a point beside it moves
    mujoco.mj_kinematics(model, data)

    stands = data.xpos[model.jnt_bodyid[0], :2]
    if np.abs(stands - asked).max() > 1e-6:
        raise ValueError(
            f"with its torso at {asked.tolist()} in qpos it is at {stands.round(3).tolist()}: the "
            "body of the root's joints must be neither turned nor moved against them"
        )
