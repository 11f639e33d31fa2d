"""Where a robot's parts are: every geom as a capsule, for silhouettes and drawings.

Forward kinematics unrolled over the robot's few bodies, in plain `jnp`: it compiles in a second,
runs in any batch, and takes geoms that MJX's collision functions don't know.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

Capsules = tuple[Float[Array, "G 3"], Float[Array, "G 3"], Float[Array, " G"]]
"""Start points, end points and radii of G capsules, in units."""


class LocalCapsules(NamedTuple):
    """The robot's geoms as capsules in the frames of their bodies, in metres.

    Attributes:
      geom: int64 [G], ids of the geoms.
      start: float64 [G, 3], start points.
      end: float64 [G, 3], end points.
      radius: float64 [G].
    """

    geom: Int[np.ndarray, " G"]
    start: Float[np.ndarray, "G 3"]
    end: Float[np.ndarray, "G 3"]
    radius: Float[np.ndarray, " G"]


def local_capsules(model: mujoco.MjModel) -> LocalCapsules:
    """Returns the robot's geoms as capsules, floor and mocap walls left out."""
    is_own = (model.geom_bodyid > 0) & (model.body_mocapid[model.geom_bodyid] < 0)
    geom = np.flatnonzero(is_own)
    parts = [_local_capsule(model, index) for index in geom.tolist()]
    start, end, radius = (np.array(part) for part in zip(*parts, strict=True))
    return LocalCapsules(geom, start, end, radius)


def capsules(
    model: mujoco.MjModel, units_per_metre: float = 1.0
) -> Callable[[Float[Array, " nq"]], Capsules]:
    """Returns the function from a robot's `qpos` to its geoms as capsules.

    Args:
      model: the robot alone, or with floor and mocap walls, which are left out.
      units_per_metre: of the robot, see `robots.robot.Robot`; x and y of a root are in units.

    Returns:
      A pure function of `qpos` [nq] that returns start points [G, 3], end points [G, 3] and radii
      [G] in units, one row per geom of the robot in the model's order; usable inside `jit` and
      `vmap`. A sphere is a capsule of length zero; other shapes are inside their capsule.
    """
    body_ids = [i for i in range(1, model.nbody) if model.body_mocapid[i] < 0]
    local = local_capsules(model)
    slots = np.array([body_ids.index(model.geom_bodyid[i]) for i in local.geom])

    def of_qpos(qpos: Float[Array, " nq"]) -> Capsules:
        qpos = qpos.at[:2].divide(units_per_metre)
        frames = {0: (jnp.zeros(3), jnp.eye(3))}
        for body in body_ids:
            frames[body] = _body_frame(model, body, frames[model.body_parentid[body]], qpos)
        xpos = jnp.stack([frames[body][0] for body in body_ids])[slots]
        xmat = jnp.stack([frames[body][1] for body in body_ids])[slots]
        start, end = (xpos + _times(xmat, end) for end in (local.start, local.end))
        radius = jnp.asarray(local.radius, jnp.float32)
        return start * units_per_metre, end * units_per_metre, radius * units_per_metre

    return of_qpos


def _body_frame(
    model: mujoco.MjModel,
    body: int,
    parent: tuple[Float[Array, "3"], Float[Array, "3 3"]],
    qpos: Float[Array, " nq"],
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Returns a body's position and rotation matrix in the world, given its parent's."""
    pos = parent[0] + _times(parent[1], model.body_pos[body])
    mat = parent[1] @ _constant(_matrix(model.body_quat[body]))
    first = model.body_jntadr[body]
    for joint in range(first, first + model.body_jntnum[body]):
        address = model.jnt_qposadr[joint]
        kind = mujoco.mjtJoint(model.jnt_type[joint])
        anchor, axis = model.jnt_pos[joint], model.jnt_axis[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            pos, mat = qpos[address : address + 3], _rotation(qpos[address + 3 : address + 7])
            continue

        moved = qpos[address] - _constant(model.qpos0[address])
        if kind == mujoco.mjtJoint.mjJNT_SLIDE:
            pos = pos + _times(mat, axis) * moved
            continue

        # Ball and hinge turn the body around the joint's anchor.
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            turn = _rotation(qpos[address : address + 4])
        else:
            turn = _rotation_about(axis, moved)
        turned = mat @ turn
        pos = pos + _times(mat - turned, anchor)  # the joint's anchor stays where it is
        mat = turned
    return pos, mat


def _local_capsule(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns the capsule around a geom in its body's frame: start, end, radius."""
    size = model.geom_size[geom]
    centre, axis = np.zeros(3), 2
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        radius, half_length = size[0], 0.0
    elif kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        radius, half_length = size[0], size[1]
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        axis = int(np.argmax(size))
        radius = np.max(np.delete(size, axis))
        half_length = size[axis] - radius
    else:  # boxes, and the bounding boxes of meshes
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        axis = int(np.argmax(half))
        radius, half_length = np.linalg.norm(np.delete(half, axis)), half[axis]
    along = half_length * np.eye(3)[axis]
    rotation = _matrix(model.geom_quat[geom])
    ends = [model.geom_pos[geom] + rotation @ (centre + s * along) for s in (-1, 1)]
    return ends[0], ends[1], float(radius)


def _matrix(quat: np.ndarray) -> np.ndarray:
    """Returns the rotation matrix [3, 3] of a constant unit quaternion (scalar part first)."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quat)
    return flat.reshape(3, 3)


def _rotation(quat: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Returns the rotation matrix of a quaternion of any length (scalar part first)."""
    outer = jnp.outer(quat, quat) / (quat @ quat)  # MuJoCo too scales it to unit length
    cross = _cross_matrix(outer[0, 1:])
    trace = outer[1, 1] + outer[2, 2] + outer[3, 3]
    return (outer[0, 0] - trace) * jnp.eye(3) + 2.0 * (outer[1:, 1:] + cross)


def _rotation_about(axis: np.ndarray, angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Returns the rotation matrix about a constant unit axis (Rodrigues' formula)."""
    cross = np.cross(np.eye(3), axis)
    return (
        jnp.eye(3)
        + jnp.sin(angle) * _constant(cross)
        + (1.0 - jnp.cos(angle)) * _constant(cross @ cross)
    )


def _cross_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Returns the matrix C with C @ u equal to the cross product of `vector` and u."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    return jnp.stack([jnp.stack(row) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))])


def _times(matrix: Float[Array, "*any 3 3"], vector: np.ndarray) -> Float[Array, "*any 3"]:
    """Returns matrix-vector products with constant vectors."""
    return jnp.einsum("...ij,...j->...i", matrix, _constant(vector))


def _constant(value: np.ndarray | float) -> np.ndarray:
    """Keeps the model's float64 numbers from widening the result."""
    return np.asarray(value, np.float32)
