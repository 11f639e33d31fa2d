"""A small ray caster for robots: capsules, a floor, one light. Needs no OpenGL.

World coordinates are units with z up and the floor at z = 0. A vector field over the pixels is a
tuple of its three components, which XLA handles several times faster on CPU than an array whose
last axis has length three.
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


class Hit(struct.PyTreeNode):
    """What the rays of H x W pixels meet first.

    Attributes:
      distance: [H, W], along the ray, units; `FAR` for nothing.
      normal: three times [H, W], unit surface normal.
      index: int32 [H, W], index of the capsule; -1 for nothing.
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


def capsules(
    origin: Vector,
    direction: Vector,
    start: Float[Array, "G 3"],
    end: Float[Array, "G 3"],
    radius: Float[Array, " G"],
) -> Hit:
    """Intersects rays with capsules: the sides of cylinders between their ends, and two balls each.

    Args:
      origin: where the rays start, the same for all or each its own.
      direction: unit directions [H, W].
      start: where the axes of G capsules begin.
      end: where they end.
      radius: of each.
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
