"""Robots in the picture of a maze, seen from above at a slant, and small pictures of patches.

A picture is computed at twice its size and averaged at the end.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import palette, raycast, scenery

SUPERSAMPLING = 2  # along each side: four rays per pixel

_NEAR = 20.0  # units from the torso at which rays begin, beyond all of a robot

_BEHIND_WALL = 0.75
"""Opacity of what a wall hides of the robot: the wall is as good as cut away there."""


@jax.jit
def draw_robot(
    origin: Float[Array, "3 H W"],
    direction: Float[Array, "3 H W"],
    start: Float[Array, "G 3"],
    end: Float[Array, "G 3"],
    radius: Float[Array, " G"],
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"], Bool[Array, "H W"]]:
    """Draws a robot's capsules in a window of the picture.

    Args:
      origin: where the rays of the window's pixels start, units; near, since thin limbs are lost in
        the rounding of long ways.
      direction: unit directions of them.
      start: one end of each geom's axis, units; the first geom is the torso.
      end: the other end.
      radius: of each geom, units.

    Returns:
      Colour, distance (`raycast.FAR` beside the robot), and where its shadow falls on the floor.
    """
    light = raycast.vector(jnp.array(scenery.LIGHT))
    eye, ray = (origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2])

    # Diffuse light, in which parts shade each other, and a highlight (Blinn and Phong).
    hit = raycast.capsules(eye, ray, start, end, radius)
    point = raycast.along(eye, ray, hit.distance)
    is_dark = raycast.capsules(*raycast.to_light(point, hit.normal, light), start, end, radius)
    lambert = jnp.maximum(raycast.dot(hit.normal, light), 0.0)
    lambert = lambert * jnp.where(is_dark.index >= 0, 0.35, 1.0)
    x, y, z = (towards - way for towards, way in zip(light, ray, strict=True))
    halfway = raycast.unit((x, y, z))
    gloss = 0.30 * jnp.maximum(raycast.dot(hit.normal, halfway), 0.0) ** 30
    shade = 0.48 + 0.08 * hit.normal[2] + 0.52 * lambert
    torso, limb = palette.rgb(palette.ROBOT), palette.rgb(palette.ROBOT_LIMB)
    surface = jnp.where((hit.index == 0)[..., None], torso[None, None], limb[None, None])
    colour = (surface * shade[..., None] + gloss[..., None]).clip(0.0, 1.0)

    # The floor is dark where the robot is between it and the light.
    up = raycast.vector(jnp.array([0.0, 0.0, 1.0]))
    point = raycast.along(eye, ray, raycast.floor_distance(eye, ray))
    shadow = raycast.capsules(*raycast.to_light(point, up, light), start, end, radius)
    return colour, hit.distance, shadow.index >= 0


def place_robot(
    canvas: UInt8[np.ndarray, "H W 3"],
    camera: camera_lib.Camera,
    corner: Int[np.ndarray, "2"],
    behind: scenery.Region,
    capsules: tuple[Float[np.ndarray, "G 3"], Float[np.ndarray, "G 3"], Float[np.ndarray, " G"]],
) -> None:
    """Draws a robot and its shadow into a window of the picture, in place.

    Args:
      canvas: what is drawn so far.
      camera: who sees it.
      corner: column and row of the window's first pixel.
      behind: the maze in this window.
      capsules: ends and radii of the robot's geoms, units.
    """
    height, width = canvas.shape[:2]
    rays = camera.rays(corner, height=height, width=width)
    # The camera is far away: rays start near the robot, and its torso is where x = y = 0.
    start, end, radius = capsules
    middle = np.array([*start[0, :2], 0.0])
    skipped = max(float(np.linalg.norm(camera.position - start[0])) - _NEAR, 0.0)
    near = (camera.position - middle)[:, None, None] + skipped * rays.astype(float)
    ends = [(end - middle).astype(np.float32) for end in (start, end)]
    drawn = draw_robot(near.astype(np.float32), rays, *ends, radius)
    colour, distance, shadow = (np.asarray(x) for x in drawn)
    distance = distance + np.float32(skipped)

    # Its shadow falls on the floor alone; where it is behind a wall, the wall is seen through.
    is_robot = distance < raycast.FAR
    is_dark = shadow & behind.is_floor & ~is_robot
    canvas[is_dark] = ((1.0 - scenery.SHADOW) * canvas[is_dark]).astype(np.uint8)
    is_hidden = (distance >= behind.distance)[is_robot][:, None]
    opacity = np.where(is_hidden, np.float32(_BEHIND_WALL), np.float32(1.0))
    mixed = (1.0 - opacity) * canvas[is_robot] + opacity * 255.0 * colour[is_robot]
    canvas[is_robot] = (mixed + 0.5).astype(np.uint8)


def finish(canvas: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Averages a canvas down to the finished picture of half its height and width."""
    # In sums of 16 bits, a fraction of what a mean of floats would cost.
    rows = canvas[::2].astype(np.uint16) + canvas[1::2]
    return ((rows[:, ::2] + rows[:, 1::2] + 2) // 4).astype(np.uint8)


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
