"""A small ray caster for mazes and robots: boxes, capsules, a floor, one light. Needs no OpenGL.

World coordinates are units with z up and the floor at z = 0. A picture has row 0 at the top. A
vector field over the pixels is a tuple of its three components, which XLA handles several times
faster on CPU than an array whose last axis has length three.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int

from eihrl_jax.ops import tree

FAR = 1e6
"""Distance of a ray that hits nothing, units."""

_NUDGE = 1e-3
"""How far a shadow ray starts off the surface, units."""

Vector = tuple[Array, Array, Array]
"""Components x, y, z, each a scalar or of the shape of the picture [H, W]."""


class Camera(struct.PyTreeNode):
    """A pinhole camera.

    Attributes:
      position: where it is, units.
      axes: unit vectors to the right, down and forward in the picture, as rows.
      focal: pixels per unit of image plane at distance 1.
      centre: pixel column and row of the optical axis.
    """

    position: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    focal: Float[Array, ""]
    centre: Float[Array, "2"]


class Hit(struct.PyTreeNode):
    """What the rays of H x W pixels meet first.

    Attributes:
      distance: [H, W], along the ray, units; `FAR` for nothing.
      normal: three times [H, W], unit surface normal.
      index: int32 [H, W], index of the box or capsule; -1 for nothing.
    """

    distance: Float[Array, "H W"]
    normal: Vector
    index: Int[Array, "H W"]


def vector(xyz: Float[Array, "3"]) -> Vector:
    """Splits a vector into its components."""
    return xyz[0], xyz[1], xyz[2]


def dot(a: Vector, b: Vector) -> Float[Array, "..."]:
    """Multiplies vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def along(origin: Vector, direction: Vector, distance: Float[Array, "H W"]) -> Vector:
    """Returns the points at some distance along rays."""
    x, y, z = (o + distance * d for o, d in zip(origin, direction, strict=True))
    return x, y, z


def unit(a: Vector) -> Vector:
    """Scales vectors to length one."""
    scale = jax.lax.rsqrt(dot(a, a))
    return a[0] * scale, a[1] * scale, a[2] * scale


def look_at(
    position: Float[Array, "3"],
    target: Float[Array, "3"],
    focal: Float[Array, ""] | float,
    centre: Float[Array, "2"],
) -> Camera:
    """Returns a camera at `position` whose optical axis goes through `target`, upright."""
    # Image axes are x right, y down, z forward, so that depth is the third coordinate.
    forward = (target - position) / jnp.linalg.norm(target - position)
    right = jnp.cross(forward, jnp.array([0.0, 0.0, 1.0]))
    right = right / jnp.linalg.norm(right)
    axes = jnp.stack([right, jnp.cross(forward, right), forward])
    return Camera(
        position=position, axes=axes, focal=jnp.asarray(focal, jnp.float32), centre=centre
    )


def project(camera: Camera, xyz: Float[Array, "N 3"]) -> Float[Array, "N 2"]:
    """Returns pixel column and row of points in front of the camera."""
    x, y, depth = jnp.moveaxis((xyz - camera.position[None]) @ camera.axes.T, -1, 0)
    return camera.centre[None] + camera.focal * jnp.stack([x, y], -1) / depth[:, None]


def pixel_rays(camera: Camera, corner: Int[Array, "2"], *, height: int, width: int) -> Vector:
    """Returns the unit directions of the pixels of a window whose top left pixel is `corner`.

    Args:
      camera: the camera.
      corner: column and row of the window's first pixel.
      height: rows of the window, H.
      width: columns of the window, W.
    """
    # Through the middle of each pixel.
    row, column = jnp.mgrid[:height, :width].astype(jnp.float32) + 0.5
    left, top = camera.centre - corner.astype(jnp.float32)
    right, down = (column - left) / camera.focal, (row - top) / camera.focal
    axes = camera.axes
    x, y, z = (axes[0, i] * right + axes[1, i] * down + axes[2, i] for i in range(3))
    return unit((x, y, z))


def boxes(
    origin: Vector, direction: Vector, low: Float[Array, "B 3"], high: Float[Array, "B 3"]
) -> Hit:
    """Intersects rays with axis-parallel boxes.

    Args:
      origin: where the rays start, the same for all or each its own.
      direction: unit directions [H, W].
      low: lower corners of B boxes.
      high: upper corners.
    """
    # A ray parallel to a face never crosses it, but mustn't divide by zero.
    inverse = [1.0 / jnp.where(d == 0.0, 1e-9, d) for d in direction]

    def nearer(best: Hit, box: tuple[Array, Array, Array]) -> tuple[Hit, None]:
        # A box is where three slabs meet: the ray is in it from the last entry to the first exit.
        box_low, box_high, index = box
        enter, leave = [], []
        for i in range(3):
            one = (box_low[i] - origin[i]) * inverse[i]
            other = (box_high[i] - origin[i]) * inverse[i]
            enter.append(jnp.minimum(one, other))
            leave.append(jnp.maximum(one, other))
        distance = jnp.maximum(jnp.maximum(enter[0], enter[1]), enter[2])
        end = jnp.minimum(jnp.minimum(leave[0], leave[1]), leave[2])
        is_hit = (distance < end) & (distance > 0.0) & (distance < best.distance)

        # The face that was entered last is the one that is seen.
        x, y, z = (jnp.where(enter[i] == distance, -jnp.sign(direction[i]), 0.0) for i in range(3))
        return _nearest(best, is_hit, distance, (x, y, z), index), None

    return jax.lax.scan(nearer, _nothing(direction), (low, high, jnp.arange(len(low))))[0]


def capsules(
    origin: Vector,
    direction: Vector,
    start: Float[Array, "G 3"],
    end: Float[Array, "G 3"],
    radius: Float[Array, " G"],
) -> Hit:
    """Intersects rays with capsules; see `boxes`.

    A capsule's surface is the side of its cylinder between the ends, and two balls.
    """

    def nearer(best: Hit, capsule: tuple[Array, ...]) -> tuple[Hit, None]:
        start_xyz, end_xyz, r, index = capsule
        span = end_xyz - start_xyz
        length = jnp.linalg.norm(span)
        axis = vector(span / jnp.maximum(length, 1e-6))  # of a ball: any, for its length is 0

        # The endless cylinder counts between the capsule's ends alone.
        from_start = _minus(origin, vector(start_xyz))
        side = _cylinder(from_start, direction, axis, r)
        height = dot(from_start, axis) + side * dot(direction, axis)
        side = jnp.where((height >= 0.0) & (height <= length), side, FAR)
        balls = jnp.minimum(
            _ball(from_start, direction, r),
            _ball(_minus(origin, vector(end_xyz)), direction, r),
        )
        distance = jnp.minimum(side, balls)

        # The normal points away from the nearest point of the axis.
        point = along(from_start, direction, distance)
        height = jnp.clip(dot(point, axis), 0.0, length)
        x, y, z = ((p - height * a) / r for p, a in zip(point, axis, strict=True))
        return _nearest(best, distance < best.distance, distance, (x, y, z), index), None

    items = (start, end, radius, jnp.arange(len(radius)))
    return jax.lax.scan(nearer, _nothing(direction), items)[0]


def floor_distance(origin: Vector, direction: Vector) -> Float[Array, "H W"]:
    """Returns the distance at which rays meet the floor, `FAR` if they don't."""
    is_down = direction[2] < 0.0
    return jnp.where(is_down, -origin[2] / jnp.where(is_down, direction[2], -1.0), FAR)


def to_light(point: Vector, normal: Vector, light: Vector) -> tuple[Vector, Vector]:
    """Returns origin and direction of the rays from surface points towards the light.

    Args:
      point: where the surfaces are.
      normal: their normals.
      light: unit vector towards the light.
    """
    origin = jax.tree.map(lambda p, n: p + _NUDGE * n, point, normal)
    return origin, jax.tree.map(lambda part: jnp.broadcast_to(part, jnp.shape(point[0])), light)


def _minus(a: Vector, b: Vector) -> Vector:
    """Subtracts vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _nothing(direction: Vector) -> Hit:
    """Returns a hit of nothing for every ray."""
    zero = jnp.zeros_like(direction[0])
    return Hit(
        distance=jnp.full_like(zero, FAR),
        normal=(zero, zero, zero),
        index=jnp.full(zero.shape, -1, jnp.int32),
    )


def _nearest(
    best: Hit, is_hit: Array, distance: Array, normal: Vector, index: Int[Array, ""]
) -> Hit:
    """Returns what rays meet first, given which of them hit the thing `index` before all else."""
    new = Hit(distance=distance, normal=normal, index=jnp.full_like(best.index, index))
    return tree.where(is_hit, new, best)


def _first_root(
    a: Float[Array, "..."], half_b: Float[Array, "..."], c: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Returns the smaller root of a t² + 2 half_b t + c if it lies ahead, else `FAR`; a > 0."""
    discriminant = half_b**2 - a * c
    root = (-half_b - jnp.sqrt(jnp.maximum(discriminant, 0.0))) / a
    return jnp.where((discriminant > 0.0) & (root > 0.0), root, FAR)


def _ball(offset: Vector, direction: Vector, radius: Float[Array, ""]) -> Float[Array, "H W"]:
    """Distance to a ball from whose centre the rays start at `offset`."""
    half_b = dot(offset, direction)
    return _first_root(jnp.ones_like(half_b), half_b, dot(offset, offset) - radius**2)


def _cylinder(
    offset: Vector, direction: Vector, axis: Vector, radius: Float[Array, ""]
) -> Float[Array, "H W"]:
    """Distance to an endless cylinder on whose axis lies the point from which `offset` counts."""
    # What lies along the axis doesn't count: the circle is met in the plane across it.
    direction_along, offset_along = dot(direction, axis), dot(offset, axis)
    a = jnp.maximum(dot(direction, direction) - direction_along**2, 1e-9)
    half_b = dot(direction, offset) - direction_along * offset_along
    c = dot(offset, offset) - offset_along**2 - radius**2
    return _first_root(a, half_b, c)
