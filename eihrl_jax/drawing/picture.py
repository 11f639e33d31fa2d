"""Pictures of a maze and a robot in it, seen from above at a slant; drawn by `raycast`.

Walls are drawn lower than they are, so that they hide nothing. A picture is computed at twice its
size and averaged at the end.
"""

import dataclasses
import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax import base
from eihrl_jax.drawing import palette, raycast
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import tree
from eihrl_jax.physics import kinematics

SUPERSAMPLING = 2  # along each side: four rays per pixel
WALL_HEIGHT = 1.1
"""Drawn height of the walls, units."""

RING = 1.5
"""Drawn thickness of the outer ring, units; the rest of it is cut off."""

PITCH = math.radians(62.0)
"""Angle of the optical axis below the horizon."""

_FIELD = 3.2
"""Distance of the camera in widths of the maze: the larger, the weaker the perspective."""

_LIGHT = (-0.48, -0.28, 0.83)
"""Unit vector towards the light: from the left, a little from the front."""

_AMBIENT = 0.60  # share of the light that comes from everywhere
_SHADOW = 0.30  # share of the floor's colour that the robot's shadow takes


@dataclasses.dataclass(frozen=True)
class Backdrop:
    """A maze without robot, at `SUPERSAMPLING` times the size of the picture.

    Attributes:
      camera: the camera, in pixels of this array.
      colour: [H, W, 3] in [0, 1].
      distance: [H, W], from the camera to what is seen, units.
      goal: int [H, W], number of the goal region on whose floor a pixel lies, 0 elsewhere.
      is_floor: [H, W], pixels of the floor inside the maze.
      pixels_per_unit: scale at the maze's centre.
    """

    camera: raycast.Camera
    colour: Float[np.ndarray, "H W 3"]
    distance: Float[np.ndarray, "H W"]
    goal: Int[np.ndarray, "H W"]
    is_floor: Bool[np.ndarray, "H W"]
    pixels_per_unit: float


def wall_rectangles(wall: Bool[np.ndarray, "R C"]) -> Int[np.ndarray, "B 4"]:
    """Covers the wall cells with few rectangles.

    Returns:
      First row, first column, last row + 1 and last column + 1 of each; they don't overlap.
    """
    left = wall.copy()
    rectangles = []
    for i, j in np.argwhere(wall):
        if not left[i, j]:
            continue

        # From its first cell as far right as there is wall, then as far down as all of that is.
        width = int(np.argmin(np.append(left[i, j:], False)))
        height = int(np.argmin(np.append(left[i:, j : j + width].all(1), False)))
        left[i : i + height, j : j + width] = False
        rectangles.append((i, j, i + height, j + width))

    return np.array(rectangles, int).reshape(-1, 4)


def wall_boxes(
    wall: Bool[np.ndarray, "R C"],
) -> tuple[Float[np.ndarray, "B 3"], Float[np.ndarray, "B 3"]]:
    """Returns lower and upper corners of boxes that cover the wall cells, units."""
    i0, j0, i1, j1 = wall_rectangles(wall).T
    zero = np.zeros(len(i0))
    low = np.stack([j0 * base.CELL, -i1 * base.CELL, zero], -1)
    high = np.stack([j1 * base.CELL, -i0 * base.CELL, zero + WALL_HEIGHT], -1)
    area = drawn_area(*wall.shape)
    return np.clip(low, *area).astype(np.float32), np.clip(high, *area).astype(np.float32)


def drawn_area(
    num_rows: int, num_columns: int
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Returns lower and upper corner of what is drawn of a maze, units; see `RING`."""
    cut = base.CELL - RING
    low = np.array([cut, cut - num_rows * base.CELL, 0.0], np.float32)
    high = np.array([num_columns * base.CELL - cut, -cut, WALL_HEIGHT], np.float32)
    return low, high


def fit_camera(num_rows: int, num_columns: int, *, width: int, height: int) -> raycast.Camera:
    """Returns the camera that sees a whole maze as large as possible in `width` x `height` pixels.

    Args:
      num_rows: rows of the maze, its outer ring included.
      num_columns: columns of it.
      width: of the picture, pixels.
      height: of the picture, pixels.
    """
    # A camera of focal length 1 in the right place and direction ...
    low, high = drawn_area(num_rows, num_columns)
    size, centre = high - low, (high + low) / 2
    back = np.array([0.0, -np.cos(PITCH), np.sin(PITCH)])
    position = centre + _FIELD * size.max() * back
    unit = raycast.look_at(
        jnp.asarray(position, jnp.float32), jnp.asarray(centre, jnp.float32), 1.0, jnp.zeros(2)
    )

    # ... tells how large the maze is in its picture, which then fills the frame.
    corner = np.array(list(itertools.product(*np.stack([low, high], -1))))
    image = np.asarray(raycast.project(unit, jnp.asarray(corner, jnp.float32)))
    low, high = image.min(0), image.max(0)
    focal = 0.97 * min(width / (high - low)[0], height / (high - low)[1])
    middle = np.array([width, height]) / 2 - focal * (low + high) / 2
    return unit.replace(
        focal=jnp.asarray(focal, jnp.float32), centre=jnp.asarray(middle, jnp.float32)
    )


def draw_maze(maze: maze_lib.Maze, *, width: int, height: int) -> Backdrop:
    """Draws a maze whose door has been drawn.

    Args:
      maze: one maze.
      width: of the finished picture, pixels.
      height: of the finished picture, pixels.
    """
    rows, columns = maze.wall.shape
    size = {"width": SUPERSAMPLING * width, "height": SUPERSAMPLING * height}
    camera = fit_camera(rows, columns, **size)
    low, high = wall_boxes(np.asarray(maze.wall))
    drawn = _draw_maze(camera, maze, jnp.asarray(low), jnp.asarray(high), **size)

    # A focal length over a depth is pixels per unit there.
    centre = np.mean(drawn_area(rows, columns), 0)
    depth = float(np.linalg.norm(np.asarray(camera.position) - centre))
    colour, distance, goal, is_floor = (np.array(x) for x in drawn)
    return Backdrop(camera, colour, distance, goal, is_floor, float(camera.focal) / depth)


@functools.partial(jax.jit, static_argnames=("width", "height"))
def _draw_maze(
    camera: raycast.Camera,
    maze: maze_lib.Maze,
    low: Float[Array, "B 3"],
    high: Float[Array, "B 3"],
    *,
    width: int,
    height: int,
) -> tuple[Array, Array, Array, Array]:
    """Computes colour, distance, goal number and floor mask of a `Backdrop`."""
    corner = jnp.zeros(2, jnp.int32)
    direction = raycast.pixel_rays(camera, corner, height=height, width=width)
    eye = raycast.vector(camera.position)

    # What each pixel shows: a wall, the floor of some cell, or the paper around the maze.
    wall = raycast.boxes(eye, direction, low, high)
    floor = raycast.floor_distance(eye, direction)
    distance = jnp.minimum(wall.distance, floor)
    point = raycast.along(eye, direction, distance)
    x, y, _ = point
    i = jnp.floor(-y / base.CELL).astype(jnp.int32)
    j = jnp.floor(x / base.CELL).astype(jnp.int32)
    rows, columns = maze.wall.shape
    area_low, area_high = drawn_area(rows, columns)
    is_inside = (x > area_low[0]) & (x < area_high[0]) & (y > area_low[1]) & (y < area_high[1])
    is_floor = (floor < wall.distance) & is_inside
    goal = jnp.where(is_floor, maze.goal[i.clip(0, rows - 1), j.clip(0, columns - 1)], 0)

    # Diffuse light with shadows, darker at the foot of walls.
    normal = tree.where(is_floor, _up(), wall.normal)
    light = raycast.vector(jnp.array(_LIGHT))
    is_dark = raycast.boxes(*raycast.to_light(point, normal, light), low, high).index >= 0
    lambert = jnp.maximum(raycast.dot(normal, light), 0.0)
    lambert = lambert * jnp.where(is_dark, 1.0 - 2.0 * _SHADOW, 1.0)
    shade = _AMBIENT + (1.0 - _AMBIENT) * lambert / light[2]
    crevice = 1.0 - 0.28 * jnp.exp(-_wall_distance(x, y, low, high) / 0.55)
    shade = (shade * jnp.where(is_floor, crevice, 1.0))[..., None]

    # Tiles of a cell each show distances; what no ray hits is paper.
    tile = _choose((i + j) % 2 == 0, _rgb("FLOOR"), _rgb("FLOOR_ALTERNATE"))
    surface = jnp.where(is_floor[..., None], tile, _rgb("WALL")[None, None])
    is_seen = (is_floor | (wall.index >= 0))[..., None]
    colour = jnp.where(is_seen, surface * shade, _rgb("PAPER")[None, None])
    return colour.clip(0.0, 1.0), distance, goal, is_floor


def _up() -> raycast.Vector:
    """Returns the floor's normal."""
    return jnp.float32(0.0), jnp.float32(0.0), jnp.float32(1.0)


def _choose(
    mask: Bool[Array, "H W"], if_true: Float[Array, "3"], if_false: Float[Array, "3"]
) -> Float[Array, "H W 3"]:
    """Returns one of two colours per pixel."""
    return jnp.where(mask[..., None], if_true[None, None], if_false[None, None])


def _rgb(name: str) -> Float[Array, "3"]:
    """Returns a colour of the palette by its name."""
    return jnp.asarray(palette.rgb(getattr(palette, name)))


def _wall_distance(
    x: Float[Array, "H W"],
    y: Float[Array, "H W"],
    low: Float[Array, "B 3"],
    high: Float[Array, "B 3"],
) -> Float[Array, "H W"]:
    """Returns the distance from points of the floor to the nearest wall, units."""

    def nearer(best: Array, box: tuple[Array, Array]) -> tuple[Array, None]:
        box_low, box_high = box
        gap_x = jnp.maximum(jnp.maximum(box_low[0] - x, x - box_high[0]), 0.0)
        gap_y = jnp.maximum(jnp.maximum(box_low[1] - y, y - box_high[1]), 0.0)
        return jnp.minimum(best, jnp.sqrt(gap_x**2 + gap_y**2)), None

    return jax.lax.scan(nearer, jnp.full_like(x, raycast.FAR), (low, high))[0]


@functools.partial(jax.jit, static_argnames=("size",))
def draw_robot(
    camera: raycast.Camera,
    corner: Int[Array, "2"],
    start: Float[Array, "G 3"],
    end: Float[Array, "G 3"],
    radius: Float[Array, " G"],
    *,
    size: int,
) -> tuple[Float[Array, "S S 3"], Float[Array, "S S"], Bool[Array, "S S"]]:
    """Draws a robot's capsules in a window of the picture.

    Args:
      camera: the camera of the backdrop.
      corner: column and row of the window's first pixel.
      start: one end of each geom's axis, units; the first geom is the torso.
      end: the other end.
      radius: of each geom, units.
      size: side of the window, pixels, S.

    Returns:
      Colour, distance (`raycast.FAR` beside the robot), and where its shadow falls on the floor.
    """
    direction = raycast.pixel_rays(camera, corner, height=size, width=size)
    eye, light = raycast.vector(camera.position), raycast.vector(jnp.array(_LIGHT))

    # Diffuse light, in which parts shade each other, and a highlight (Blinn and Phong).
    hit = raycast.capsules(eye, direction, start, end, radius)
    point = raycast.along(eye, direction, hit.distance)
    is_dark = raycast.capsules(*raycast.to_light(point, hit.normal, light), start, end, radius)
    lambert = jnp.maximum(raycast.dot(hit.normal, light), 0.0)
    lambert = lambert * jnp.where(is_dark.index >= 0, 0.35, 1.0)
    x, y, z = (towards - ray for towards, ray in zip(light, direction, strict=True))
    halfway = raycast.unit((x, y, z))
    gloss = 0.30 * jnp.maximum(raycast.dot(hit.normal, halfway), 0.0) ** 30
    shade = 0.48 + 0.08 * hit.normal[2] + 0.52 * lambert
    surface = _choose(hit.index == 0, _rgb("ROBOT"), _rgb("ROBOT_LIMB"))
    colour = (surface * shade[..., None] + gloss[..., None]).clip(0.0, 1.0)

    # The floor is dark where the robot is between it and the light.
    point = raycast.along(eye, direction, raycast.floor_distance(eye, direction))
    shadow = raycast.capsules(*raycast.to_light(point, _up(), light), start, end, radius)
    return colour, hit.distance, shadow.index >= 0


def place_robot(
    canvas: Float[np.ndarray, "H W 3"],
    backdrop: Backdrop,
    capsules: kinematics.Capsules,
    *,
    reach: float,
) -> None:
    """Draws a robot and its shadow into a canvas of the backdrop's size, in place.

    Args:
      canvas: what is drawn so far.
      backdrop: the maze.
      capsules: ends and radii of the robot's geoms, units.
      reach: distance from the torso within which robot and shadow lie, units.
    """
    start, end, radius = capsules
    height, width = canvas.shape[:2]

    # Only a window around the robot is drawn, as large for every frame: it is compiled once.
    size = min(2 * int(np.ceil(1.15 * reach * backdrop.pixels_per_unit)), height, width)
    torso = raycast.project(backdrop.camera, (start[:1] + end[:1]) / 2)
    corner = np.round(np.asarray(torso)[0] - size / 2).astype(int)
    corner = np.clip(corner, 0, [width - size, height - size])
    drawn = draw_robot(
        backdrop.camera, jnp.asarray(corner, jnp.int32), start, end, radius, size=size
    )
    colour, distance, shadow = (np.asarray(x) for x in drawn)

    # Walls in front of the robot hide it, and its shadow falls on the floor alone.
    window = np.s_[corner[1] : corner[1] + size, corner[0] : corner[0] + size]
    part = canvas[window]
    part[shadow & backdrop.is_floor[window]] *= 1.0 - _SHADOW
    is_robot = distance < backdrop.distance[window]
    part[is_robot] = colour[is_robot]


def finish(canvas: Float[np.ndarray, "H W 3"]) -> np.ndarray:
    """Averages a canvas down to the finished picture, uint8 [H / 2, W / 2, 3]."""
    n = SUPERSAMPLING
    parts = np.stack([canvas[i::n, j::n] for i, j in np.ndindex(n, n)])
    return (255.0 * parts.mean(0) + 0.5).astype(np.uint8)


def colour_patch(patch: Bool[np.ndarray, "P P C"]) -> Float[np.ndarray, "P P 3"]:
    """Colours what a high level sees, in [0, 1]: walls, goals and robot as in the large picture.

    Args:
      patch: channels wall, unvisited goal, robot; a later one hides an earlier one. On a map the
        fourth is what hasn't been seen.
    """
    colours = (palette.WALL, palette.GOAL, palette.ROBOT, palette.UNSEEN)
    image = np.full((*patch.shape[:2], 3), palette.rgb(palette.FLOOR))
    for mask, colour in zip(np.moveaxis(patch, -1, 0), colours, strict=False):
        image[mask] = palette.rgb(colour)
    return image
