"""The low level's observation, its features, and the conversion between actions and controls.

In the direction's frame the world is turned such that the subgoal points along x+, so the network
learns one direction only. In the canonical frame the robot's parts are also renamed by its body's
symmetry, such that the body faces the subgoal and is turned to its left if at all: an ant, which
looks the same from four sides and in a mirror, has an eighth of the postures left to learn.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.ops import rotations
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.robots import symmetry as symmetry_lib


class LowObs(struct.PyTreeNode):
    """The low level's observation. P: size of the proprioception.

    Attributes:
      proprioception: float32 [P], qpos without x and y, then qvel; units, radians, per second.
      displacement_xy: float32 [2], displacement from the subgoal's origin (where the torso was when
        it was given, or its anchor, see `task.anchor`), units, world frame.
      time_left: float32, fraction of the subgoal's k steps that is left, in (0, 1].
      direction: int32, the subgoal: 0 to 3 for x+, x-, y+, y-.
    """

    proprioception: Float[Array, " P"]
    displacement_xy: Float[Array, "2"]
    time_left: Float[Array, ""]
    direction: Int[Array, ""]


def observe(
    physics: engine_lib.PhysicsState,
    subgoal_xy: Float[Array, "2"],
    steps_left: Int[Array, ""],
    direction: Int[Array, ""],
    robot: robot_lib.Robot,
) -> LowObs:
    """Returns the low level's observation, the same in training and in the hierarchy.

    Args:
      physics: the robot's state.
      subgoal_xy: origin of the subgoal, units.
      steps_left: control steps left of the subgoal, 1 to k.
      direction: the subgoal.
      robot: the robot.
    """
    return LowObs(
        proprioception=physics.proprioception,
        displacement_xy=physics.qpos[:2] - subgoal_xy,
        time_left=steps_left.astype(jnp.float32) / robot.steps_per_subgoal,
        direction=direction,
    )


def features(
    obs: LowObs, robot: robot_lib.Robot, options: low_config.LowInput
) -> Float[Array, " num_features"]:
    """Returns the network's input: proprioception, two-hot direction, and perhaps progress.

    The two-hot code of direction d sets entries 2d and 2d + 1 of eight (paper, Table 4). In the
    other frames it is left out, since it would always be the same.
    """
    code: list[Array] = []
    if options.frame == "world":
        # Paper, Table 4: the direction as two-hot code.
        code = [jnp.repeat(jax.nn.one_hot(obs.direction, base.NUM_DIRECTIONS), 2)]
        body, displacement_xy = _split(obs.proprioception, robot), obs.displacement_xy
    else:
        body, displacement_xy = _in_direction_frame(obs, robot)

    symmetry = _symmetry(robot, options)
    if symmetry is not None:
        variant = _canonical_variant(body, displacement_xy, robot, symmetry)
        body = _rename(body, variant, robot, symmetry)
        displacement_xy = _mirror_xy(displacement_xy, variant, symmetry)

    # A quaternion and its negative are the same orientation; the network gets one of them.
    if robot.root == "free":
        body = body._replace(orientation=rotations.with_positive_w(body.orientation))
    body = body._replace(
        spin=options.velocity_scale * body.spin,
        joint_velocity=options.velocity_scale * body.joint_velocity,
    )
    if robot.sensors == "onboard":
        nothing = jnp.zeros(0)
        body = body._replace(height=nothing, velocity_xy=nothing, velocity_z=nothing)

    progress = [displacement_xy / base.CELL, obs.time_left[None]] if options.use_progress else []
    return jnp.concatenate([*body, *code, *progress])


def ctrl_from_action(
    action: Float[Array, " nu"],
    obs: LowObs,
    robot: robot_lib.Robot,
    options: low_config.LowInput,
) -> Float[Array, " nu"]:
    """Converts a network's action, which is in the frame of its features, to controls."""
    symmetry = _symmetry(robot, options)
    if symmetry is not None:
        order, signs = symmetry_lib.inverse(*symmetry.control_tables())
        action = _reorder(action, _variant(obs, robot, symmetry), order, signs)
    action *= _scale(robot, options)
    # Only a sliding robot's first two controls are forces along the world's axes.
    if robot.root != "slide" or options.frame == "world":
        return action
    return jnp.concatenate([rotations.to_world_frame(action[:2], obs.direction), action[2:]])


def action_from_ctrl(
    ctrl: Float[Array, " nu"],
    obs: LowObs,
    robot: robot_lib.Robot,
    options: low_config.LowInput,
) -> Float[Array, " nu"]:
    """Inverse of `ctrl_from_action`."""
    if robot.root == "slide" and options.frame != "world":
        pushes = rotations.to_direction_frame(ctrl[:2], obs.direction)
        ctrl = jnp.concatenate([pushes, ctrl[2:]])
    ctrl /= _scale(robot, options)
    symmetry = _symmetry(robot, options)
    if symmetry is None:
        return ctrl
    return _reorder(ctrl, _variant(obs, robot, symmetry), *symmetry.control_tables())


def _scale(robot: robot_lib.Robot, options: low_config.LowInput) -> float:
    """Returns the controls that an action of 1 means."""
    return robot.recovery_scale if options.full_range else 1.0


class _Body(NamedTuple):
    """Proprioception in parts, in the order in which the network gets them. J: joints."""

    height: Float[Array, " 0_or_1"]
    orientation: Float[Array, " 0_or_2_or_4"]  # quaternion, or cosine and sine of the yaw
    joints: Float[Array, " J"]
    velocity_xy: Float[Array, " 0_or_2"]  # world frame
    velocity_z: Float[Array, " 0_or_1"]
    spin: Float[Array, " 0_or_1_or_3"]  # free: the body's own frame
    joint_velocity: Float[Array, " J"]


_SIZES = {"free": (1, 4, 2, 1, 3), "planar": (0, 1, 2, 0, 1), "slide": (0, 0, 2, 0, 0)}
"""Sizes of the parts by kind of root, joints left out."""


_ODD = {"free": ([0, 1, 0, 1], [1, 0, 1]), "planar": ([0, 1], [1]), "slide": ([], [])}
"""Which entries of orientation and spin change their sign in a mirror at y = 0, by kind of root."""


def _split(proprioception: Float[Array, " P"], robot: robot_lib.Robot) -> _Body:
    """Splits proprioception; a yaw becomes cosine and sine, so that full turns don't matter."""
    height, orientation, xy, z, spin = _SIZES[robot.root]
    num_joints = (proprioception.shape[0] - sum(_SIZES[robot.root])) // 2  # in qpos and in qvel
    sizes = (height, orientation, num_joints, xy, z, spin)
    body = _Body(*jnp.split(proprioception, list(itertools.accumulate(sizes))))
    if robot.root != "planar":
        return body
    yaw = body.orientation
    return body._replace(orientation=jnp.concatenate([jnp.cos(yaw), jnp.sin(yaw)]))


def _in_direction_frame(obs: LowObs, robot: robot_lib.Robot) -> tuple[_Body, Float[Array, "2"]]:
    """Returns body and displacement in a world turned such that the subgoal points along x+."""
    body, direction = _split(obs.proprioception, robot), obs.direction
    body = body._replace(velocity_xy=rotations.to_direction_frame(body.velocity_xy, direction))
    if robot.root != "slide":
        is_free = robot.root == "free"
        turn = rotations.quaternion_to_direction_frame if is_free else rotations.to_direction_frame
        body = body._replace(orientation=turn(body.orientation, direction))
    return body, rotations.to_direction_frame(obs.displacement_xy, direction)


def _symmetry(robot: robot_lib.Robot, options: low_config.LowInput) -> symmetry_lib.Symmetry | None:
    return robot.symmetry if options.frame == "canonical" else None


def _variant(
    obs: LowObs, robot: robot_lib.Robot, symmetry: symmetry_lib.Symmetry
) -> Int[Array, ""]:
    """Returns which renaming makes an observation canonical."""
    return _canonical_variant(*_in_direction_frame(obs, robot), robot, symmetry)


def _canonical_variant(
    body: _Body,
    displacement_xy: Float[Array, "2"],
    robot: robot_lib.Robot,
    symmetry: symmetry_lib.Symmetry,
) -> Int[Array, ""]:
    """Returns the variant, see `robots.symmetry.tables`, in which the body faces the subgoal.

    That is: its heading is within half a turn of the symmetry of x+, and not to the right of it. A
    sliding robot has no heading, and must not have drifted to the right instead.
    """
    heading_xy = body.orientation if robot.root == "planar" else displacement_xy
    if robot.root == "free":
        heading_xy = rotations.heading(body.orientation)

    # Turns by the symmetry's angle bring the heading next to x+, a mirror then to its left.
    pitch = 2.0 * jnp.pi / symmetry.num_turns
    angle = jnp.arctan2(heading_xy[1], heading_xy[0])
    num_turns = -jnp.round(angle / pitch)
    is_mirrored = (angle + num_turns * pitch < 0.0) & symmetry.has_mirror
    turned = num_turns.astype(jnp.int32) % symmetry.num_turns
    return turned + symmetry.num_turns * is_mirrored.astype(jnp.int32)


def _rename(
    body: _Body, variant: Int[Array, ""], robot: robot_lib.Robot, symmetry: symmetry_lib.Symmetry
) -> _Body:
    """Turns the body's axes about its z axis, mirrors the world at y = 0, renames the joints."""
    turns = (variant % symmetry.num_turns).astype(jnp.float32)
    angle = 2.0 * jnp.pi / symmetry.num_turns * turns
    orientation, spin = body.orientation, body.spin
    if robot.root == "free":
        orientation = rotations.turn_body(orientation, angle)
        spin = jnp.concatenate([rotations.turn(spin[:2], -angle), spin[2:]])
    elif robot.root == "planar":
        orientation = rotations.turn(orientation, angle)

    # In a mirror at y = 0 some components change their sign, and left and right their names.
    is_odd, is_spin_odd = (jnp.array(each, bool) for each in _ODD[robot.root])
    is_mirrored = variant >= symmetry.num_turns
    order, signs = symmetry.joint_tables()
    return body._replace(
        orientation=jnp.where(is_mirrored & is_odd, -orientation, orientation),
        joints=_reorder(body.joints, variant, order, signs),
        velocity_xy=_mirror_xy(body.velocity_xy, variant, symmetry),
        spin=jnp.where(is_mirrored & is_spin_odd, -spin, spin),
        joint_velocity=_reorder(body.joint_velocity, variant, order, signs),
    )


def _mirror_xy(
    xy: Float[Array, "2"], variant: Int[Array, ""], symmetry: symmetry_lib.Symmetry
) -> Float[Array, "2"]:
    return xy.at[1].multiply(jnp.where(variant >= symmetry.num_turns, -1.0, 1.0))


def _reorder(
    values: Float[Array, " J"], variant: Int[Array, ""], order: np.ndarray, signs: np.ndarray
) -> Float[Array, " J"]:
    return jnp.asarray(signs)[variant] * values[jnp.asarray(order)[variant]]
