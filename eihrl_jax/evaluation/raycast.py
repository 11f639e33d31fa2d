"""A small ray caster for mazes and robots: boxes, capsules, a floor, one light. Needs no OpenGL.

World coordinates are units with z up and the floor at z = 0. A picture has row 0 at the top.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

FAR = 1e6
"""Distance of a ray that hits nothing, units."""

_NUDGE = 1e-3
"""How far a shadow ray starts off the surface, units."""


@struct.dataclass
class Camera:
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


@struct.dataclass
class Hit:
    """What the rays of H x W pixels meet first.

    Attributes:
      distance: [H, W], along the ray, units; `FAR` for nothing.
      normal: [H, W, 3], unit surface normal.
      index: int32 [H, W], index of the box or capsule; -1 for nothing.
    """

    distance: Float[Array, "H W"]
    normal: Float[Array, "H W 3"]
    index: Int[Array, "H W"]


def look_at(
    position: Float[Array, "3"],
    target: Float[Array, "3"],
    focal: Float[Array, ""] | float,
    centre: Float[Array, "2"],
) -> Camera:
    """Returns a camera at `position` whose optical axis goes through `target`, upright."""
    forward = (target - position) / jnp.linalg.norm(target - position)
    right = jnp.cross(forward, jnp.array([0.0, 0.0, 1.0]))
    right = right / jnp.linalg.norm(right)
    axes = jnp.stack([right, jnp.cross(forward, right), forward])
    return Camera(
        position=position, axes=axes, focal=jnp.asarray(focal, jnp.float32), centre=centre
    )


def project(camera: Camera, xyz: Float[Array, "N 3"]) -> Float[Array, "N 2"]:
    """Returns pixel column and row of points in front of the camera."""
    x, y, depth = jnp.moveaxis((xyz - camera.position) @ camera.axes.T, -1, 0)
    return camera.centre + camera.focal * jnp.stack([x, y], -1) / depth[:, None]


def pixel_rays(
    camera: Camera, corner: Int[Array, "2"], *, height: int, width: int
) -> Float[Array, "H W 3"]:
    """Returns the unit directions of the pixels of a window whose top left pixel is `corner`.

    Args:
      camera: the camera.
      corner: column and row of the window's first pixel.
      height: rows of the window, H.
      width: columns of the window, W.
    """
    row, column = jnp.mgrid[:height, :width]
    pixel = jnp.stack([column, row], -1) + corner + 0.5
    offset = (pixel - camera.centre) / camera.focal
    direction = jnp.concatenate([offset, jnp.ones((height, width, 1))], -1) @ camera.axes
    return direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)


def boxes(
    origin: Float[Array, "... 3"],
    direction: Float[Array, "H W 3"],
    low: Float[Array, "B 3"],
    high: Float[Array, "B 3"],
) -> Hit:
    """Intersects rays with axis-parallel boxes.

    Args:
      origin: where the rays start: one point [3], or one for each ray [H, W, 3].
      direction: unit directions.
      low: lower corners of B boxes.
      high: upper corners.
    """
    inverse = 1.0 / jnp.where(direction == 0.0, 1e-9, direction)

    def nearer(best: Hit, box: tuple[Array, Array, Array]) -> tuple[Hit, None]:
        box_low, box_high, index = box
        near = jnp.minimum((box_low - origin) * inverse, (box_high - origin) * inverse)
        far = jnp.maximum((box_low - origin) * inverse, (box_high - origin) * inverse)
        distance = near.max(-1)
        is_hit = (distance < far.min(-1)) & (distance > 0.0) & (distance < best.distance)
        axis = jax.nn.one_hot(near.argmax(-1), 3)
        return _replace(best, is_hit, distance, -jnp.sign(direction) * axis, index), None

    return jax.lax.scan(nearer, _nothing(direction), (low, high, jnp.arange(len(low))))[0]


def capsules(
    origin: Float[Array, "... 3"],
    direction: Float[Array, "H W 3"],
    start: Float[Array, "G 3"],
    end: Float[Array, "G 3"],
    radius: Float[Array, " G"],
) -> Hit:
    """Intersects rays with capsules; see `boxes`.

    A capsule's surface is the side of its cylinder between the ends, and two balls.
    """

    def nearer(best: Hit, capsule: tuple[Array, ...]) -> tuple[Hit, None]:
        start_xyz, end_xyz, r, index = capsule
        length = jnp.linalg.norm(end_xyz - start_xyz)
        axis = (end_xyz - start_xyz) / jnp.maximum(length, 1e-6)
        side = _cylinder(origin - start_xyz, direction, axis, r)
        along = _dot(origin - start_xyz + side[..., None] * direction, axis)
        side = jnp.where((along >= 0.0) & (along <= length), side, FAR)
        ball_start = _ball(origin - start_xyz, direction, r)
        ball_end = _ball(origin - end_xyz, direction, r)
        distance = jnp.minimum(side, jnp.minimum(ball_start, ball_end))
        is_hit = distance < best.distance
        from_start = origin - start_xyz + distance[..., None] * direction
        along = jnp.clip(_dot(from_start, axis), 0.0, length)
        normal = (from_start - along[..., None] * axis) / r
        return _replace(best, is_hit, distance, normal, index), None

    items = (start, end, radius, jnp.arange(len(radius)))
    return jax.lax.scan(nearer, _nothing(direction), items)[0]


def floor_distance(
    origin: Float[Array, "3"], direction: Float[Array, "H W 3"]
) -> Float[Array, "H W"]:
    """Returns the distance at which rays meet the floor, `FAR` if they don't."""
    is_down = direction[..., 2] < 0.0
    return jnp.where(is_down, -origin[2] / jnp.where(is_down, direction[..., 2], 1.0), FAR)


def lit(
    point: Float[Array, "H W 3"], normal: Float[Array, "H W 3"], light: Float[Array, "3"]
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
    """Returns origin and direction of the rays from surface points towards the light.

    Args:
      point: where the surfaces are.
      normal: their normals.
      light: unit vector towards the light.
    """
    return point + _NUDGE * normal, jnp.broadcast_to(light, point.shape)


def _nothing(direction: Float[Array, "H W 3"]) -> Hit:
    """Returns a hit of nothing for every ray."""
    shape = direction.shape[:-1]
    return Hit(
        distance=jnp.full(shape, FAR),
        normal=jnp.zeros_like(direction),
        index=jnp.full(shape, -1, jnp.int32),
    )


def _replace(
    best: Hit,
    is_hit: Bool[Array, "H W"],
    distance: Float[Array, "H W"],
    normal: Float[Array, "H W 3"],
    index: Int[Array, ""],
) -> Hit:
    """Takes over those rays that hit something nearer."""
    return Hit(
        distance=jnp.where(is_hit, distance, best.distance),
        normal=jnp.where(is_hit[..., None], normal, best.normal),
        index=jnp.where(is_hit, index.astype(jnp.int32), best.index),
    )


def _dot(a: Float[Array, "... 3"], b: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Multiplies vectors along the last axis."""
    return jnp.einsum("...i,...i->...", *jnp.broadcast_arrays(a, b))


def _first_root(
    a: Float[Array, "..."], half_b: Float[Array, "..."], c: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Returns the smaller root of a t² + 2 half_b t + c if it lies ahead, else `FAR`; a > 0."""
    discriminant = half_b**2 - a * c
    root = (-half_b - jnp.sqrt(jnp.maximum(discriminant, 0.0))) / a
    return jnp.where((discriminant > 0.0) & (root > 0.0), root, FAR)


def _ball(
    offset: Float[Array, "... 3"], direction: Float[Array, "H W 3"], radius: Float[Array, ""]
) -> Float[Array, "H W"]:
    """Distance to a ball from whose centre the rays start at `offset`."""
    half_b = _dot(offset, direction)
    c = jnp.broadcast_to(_dot(offset, offset) - radius**2, half_b.shape)
    return _first_root(jnp.ones_like(half_b), half_b, c)


def _cylinder(
    offset: Float[Array, "... 3"],
    direction: Float[Array, "H W 3"],
    axis: Float[Array, "3"],
    radius: Float[Array, ""],
) -> Float[Array, "H W"]:
    """Distance to an endless cylinder from whose axis the rays start at `offset`."""
    across = direction - _dot(direction, axis)[..., None] * axis
    offset = offset - _dot(offset, axis)[..., None] * axis
    a = jnp.maximum(_dot(across, across), 1e-9)
    half_b = _dot(across, offset)
    c = jnp.broadcast_to(_dot(offset, offset) - radius**2, half_b.shape)
    return _first_root(a, half_b, c)
