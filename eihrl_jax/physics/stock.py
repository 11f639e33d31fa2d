"""Makes the robot's part of a scene out of any MJCF, whatever else stands in its file.

Kept are the robot's bodies, joints, tendons, equalities and actuators, and the options of the
physics. Left out are the file's own world: floor, lights, cameras, sensors, other bodies.
"""

import dataclasses
import warnings

import mujoco

from eihrl_jax.robots import robot as robot_lib

BOTH, FLOOR_ONLY, WALLS_ONLY = 1, 2, 4
"""Values of `contype` of a robot's geoms, by what they collide with."""

_KINDS = (BOTH, FLOOR_ONLY, WALLS_ONLY)
_FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)


@dataclasses.dataclass(frozen=True)
class Adapted:
    """Changes that remain to be made once the model is compiled.

    Attributes:
      is_ours: the file says in `contype` whether floor or walls are met, see `docs/robots.md`.
      has_keyframe: the model's keyframe is one of the file's.
      mass: kilograms that all of the robot has to have; None: what its parts have.
    """

    is_ours: bool
    has_keyframe: bool
    mass: float | None


def adapt(spec: mujoco.MjSpec, robot: robot_lib.Robot) -> Adapted:
    """Removes everything but the robot from `spec`, so that floor and walls can be added.

    Args:
      spec: as its file has it; changed in place.
      robot: its description.

    Raises:
      ValueError: there is no robot in it, or the description doesn't fit; in one line.
    """
    root = torso(spec)
    mass = _told_mass(spec)
    own = [geom for body in (root, *root.find_all("body")) for geom in body.geoms]
    is_ours = not spec.pairs and all(
        geom.conaffinity == 0 and geom.contype in (0, *_KINDS) for geom in own
    )
    # A robot of which nothing could ever touch a wall was made for a world without any.
    is_ours &= any(geom.contype for geom in own)
    if not is_ours:
        _collide(own, spec, robot)
    for geom in own:
        geom.conaffinity = 0

    # What may refer to parts that are gone goes too; floor and walls bring contacts of their own.
    for body in spec.worldbody.bodies:
        if body != root:
            spec.delete(body)
    world = (spec.worldbody.geoms, spec.sensors, spec.cameras, spec.lights)
    for element in [x for group in (*world, spec.pairs, spec.excludes) for x in group]:
        spec.delete(element)

    is_same_root = _set_root(spec, root, robot)
    has_keyframe = _choose_keyframe(spec, robot, is_same_root)
    for actuator in spec.actuators:
        # A filter only delays: without it the same control has the same effect a little earlier.
        if actuator.dyntype in _FILTERS:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
            actuator.actdim = -1
    return Adapted(is_ours, has_keyframe, mass)


def torso(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Returns the root of the largest tree of bodies that stands in the world.

    Raises:
      ValueError: there is none, or nothing in it could be seen; in one line.
    """
    trees = [body for body in spec.worldbody.bodies if not body.mocap]
    if not trees:
        raise ValueError("it has no body that could move")
    largest = max(trees, key=lambda body: len(body.find_all("body")))
    if not largest.find_all("geom"):
        raise ValueError("it has no geom that could be seen or touch anything")
    return largest


def set_mass(model: mujoco.MjModel, mass: float) -> None:
    """Scales a compiled robot to so many kilograms; walls keep theirs.

    Args:
      model: a robot's scene; changed in place.
      mass: of all of the robot.
    """
    is_robot = model.body_mocapid < 0
    scale = mass / model.body_mass[is_robot].sum()
    model.body_mass[is_robot] *= scale
    model.body_inertia[is_robot] *= scale
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _told_mass(spec: mujoco.MjSpec) -> float | None:
    """Takes a total mass out of the spec, and returns the robot's part of it.

    MuJoCo would share it out again, to the walls as well, which weigh more than any robot.
    """
    if spec.compiler.settotalmass <= 0.0:
        return None

    as_it_is = spec.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # The option is deprecated, and the file somebody else's.
        model = as_it_is.compile()
    spec.compiler.settotalmass = -1.0
    return float(model.body_subtreemass[torso(as_it_is).id])


def _collide(own: list[mujoco.MjsGeom], spec: mujoco.MjSpec, robot: robot_lib.Robot) -> None:
    """Lets all geoms of the robot that collide with anything meet floor and walls."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    solid = [geom for geom in own if geom.contype or geom.conaffinity or geom.name in paired]
    # What slides in the plane can't fall, and would only be braked by the floor.
    kind = BOTH if robot.root == "free" else WALLS_ONLY
    for geom in own:
        geom.contype = kind if geom in solid or not solid else 0
        geom.margin = geom.gap = 0.0  # MJX ignores margins between boxes and round geoms


def _set_root(spec: mujoco.MjSpec, torso: mujoco.MjsBody, robot: robot_lib.Robot) -> bool:
    """Joins the torso to the world as the description says; returns whether it was so before."""
    joints = list(torso.joints)
    if robot.root == "free":
        if [joint.type for joint in joints] == [mujoco.mjtJoint.mjJNT_FREE]:
            return True
        # Such as a runner's, which slides and turns in a vertical plane, or none at all.
        for joint in joints:
            spec.delete(joint)
        torso.add_freejoint()
        return False

    # Positions are then the torso's in the world, and nothing but walls holds it.
    torso.pos = [0.0, 0.0, torso.pos[2]]
    for joint in joints[: 3 if robot.root == "planar" else 2]:
        joint.ref = joint.springref = 0.0
        joint.stiffness = [0.0] * len(joint.stiffness)
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    return True


def _choose_keyframe(spec: mujoco.MjSpec, robot: robot_lib.Robot, is_same_root: bool) -> bool:
    """Leaves one keyframe, and returns whether it is one of the file's.

    Raises:
      ValueError: the description names one that there isn't.
    """
    names = [key.name for key in spec.keys]
    if robot.keyframe is not None and robot.keyframe not in names:
        there = ", ".join(filter(None, names)) or "none with a name"
        raise ValueError(f"keyframe = {robot.keyframe!r} isn't in it; there is {there}")

    # Another root or another body has other numbers in a keyframe.
    is_usable = is_same_root and bool(names)
    wanted = names.index(robot.keyframe) if robot.keyframe is not None else 0
    for index, key in enumerate(list(spec.keys)):
        if index != wanted or not is_usable:
            spec.delete(key)
    if not is_usable:
        spec.add_key(name="stand")
    return is_usable
