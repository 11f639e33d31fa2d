"""A description for any MJCF: what can be measured of it is, what can't be is guessed."""

import dataclasses
import pathlib
import re

import mujoco
import numpy as np

from eihrl_jax import base, robots
from eihrl_jax.physics import posture, scene, stock, trials
from eihrl_jax.robots import mjcf as mjcf_lib
from eihrl_jax.robots import robot as robot_lib

_CONTROL_STEP = 0.05
"""Seconds of a control step, as nearly as the file's time step allows."""

_CELL_SECONDS = 5.0
"""Time for a cell."""

_FITTING = 0.4, 2.5
"""Reach in metres between which the usual cell of 3 m fits."""

_CELLS_PER_REACH = 2.4
"""Of a robot that is smaller or larger; the ant's."""

_HEALTHY = 0.55, 1.9
"""Lowest and greatest healthy height, in heights of the start posture."""


def propose(mjcf: pathlib.Path) -> robot_lib.Robot:
    """Returns a description for an MJCF file.

    Args:
      mjcf: the file, whatever it was made for.

    Raises:
      base.UserError: it can't be read, or no robot can be made of it.
    """
    # MuJoCo's own message doesn't say that there is no such file.
    if not mjcf.is_file():
        raise base.UserError(f"robot {str(mjcf)!r}: there is no such file")
    try:
        spec = mjcf_lib.load(mjcf)
        root = _root(stock.torso(spec))
    except ValueError as error:
        raise base.UserError(f"robot {str(mjcf)!r}: {' '.join(str(error).split())}") from None

    # Any sizes will do to build it and measure them.
    step = min(float(spec.option.timestep), 0.02)
    num_substeps = max(1, round(_CONTROL_STEP / step))
    draft = robot_lib.Robot(
        name=_name(spec.modelname or mjcf.stem),
        mjcf=mjcf,
        root=root,
        physics_step=step,
        num_substeps=num_substeps,
        steps_per_subgoal=max(2, round(_CELL_SECONDS / (step * num_substeps))),
        reach=100.0,
        body_radius=1.0,
        cell=100.0,
    )
    return _measured(draft)


def _measured(draft: robot_lib.Robot) -> robot_lib.Robot:
    """Returns a description whose sizes and speed are those of the model."""
    model = scene.build(draft)
    start = model.key_qpos[0]
    reach = 1.05 * posture.reach(model, draft)
    smallest, greatest = _FITTING
    cell = base.CELL if smallest <= reach <= greatest else _CELLS_PER_REACH * reach

    # Between walls it has to fit with its narrow side.
    narrow = float(posture.sides(model, start).min()) / 2
    radius = float(np.clip(narrow, 0.05 * cell, 0.45 * cell))
    healthy_z = None
    if draft.root == "free":
        lowest, highest = (round(float(share * start[2]), 2) for share in _HEALTHY)
        healthy_z = lowest, highest

    slow = dataclasses.replace(
        draft,
        reach=round(reach, 2),
        body_radius=round(radius, 2),
        cell=round(cell, 2),
        healthy_z=healthy_z,
    )
    speed = trials.top_speed(model, draft)
    is_held = speed * slow.control_step * slow.units_per_metre <= slow.max_travel
    # What even eight boxes don't hold is a fault that the trial tells.
    if is_held or 1.05 * speed * slow.control_step >= slow.cell - slow.body_radius:
        return slow
    return dataclasses.replace(slow, max_speed=round(1.05 * speed, 1))


def _root(torso: mujoco.MjsBody) -> robot_lib.Root:
    """Returns how a torso is joined to the world; "free" where its joints have to be replaced."""
    joints = list(torso.joints)
    axes = [tuple(np.round(joint.axis, 6)) for joint in joints]
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    if [joint.type for joint in joints[:2]] != [slide, slide] or axes[:2] != [(1, 0, 0), (0, 1, 0)]:
        return "free"
    if len(joints) > 2 and joints[2].type == hinge and axes[2] == (0, 0, 1):
        return "planar"
    return "slide"


def _name(text: str) -> str:
    """Returns a name that a description may have."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-_") or "robot"
    return f"my-{name}" if name in robots.NAMES else name
