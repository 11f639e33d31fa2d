"""Where an animation's camera looks: at the whole maze, or along with a robot that is small."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.mazes import maze as maze_lib

_SMALL = 0.055
"""Share of the picture's width below which a robot is small in it."""

_LARGE = 0.1
"""Share of the picture's width that a robot is given by a camera that follows it."""

_MIN_CELLS = 3.0  # that such a camera sees beside each other, so that one knows where the robot is
_ZONE = 0.36  # share of the picture, to each side of its middle, in which the robot moves freely
_LEAD = 0.85  # of its way to the robot the camera goes on so far beyond it
_GLIDE = 0.65  # share of its way that the camera goes per frame
_AT_ONCE = 0.26  # share of the picture: a way that is as short is gone in one frame
_STEP = 24.0  # pixels: for less the camera doesn't move
_MARGIN = 0.03  # share of the picture that is seen beyond the maze


@dataclasses.dataclass(frozen=True)
class Shots:
    """What is seen of a maze in each frame: a window that moves over one large picture.

    Attributes:
      camera: sees the large picture; all windows share its perspective.
      corners: int [F, 2], first column and row of the window, even.
      is_whole: whether the window is the large picture and never moves.
    """

    camera: camera_lib.Camera
    corners: Int[np.ndarray, "F 2"]
    is_whole: bool


def plan(
    maze: maze_lib.Maze,
    xy: Float[np.ndarray, "F 2"],
    reach: float,
    kind: evaluate_config.Camera,
    size: tuple[int, int],
) -> Shots:
    """Decides where the camera looks in each frame.

    Args:
      maze: the maze.
      xy: where the torso is in each frame, units.
      reach: greatest distance of any part of the robot from there, units.
      kind: whether it follows.
      size: width and height of the window, pixels.
    """
    rows, columns = maze.wall.shape
    width, height = size
    camera = camera_lib.fit(rows, columns, width=width, height=height)
    scale = camera_lib.pixels_per_unit(camera, rows, columns)
    share = 2.0 * reach * scale / width
    zoom = min(_LARGE / share, width / (_MIN_CELLS * base.CELL * scale))
    if kind == "whole" or (kind == "auto" and share >= _SMALL) or zoom <= 1.0:
        return Shots(camera, np.zeros((len(xy), 2), int), is_whole=True)

    camera = camera_lib.fit(rows, columns, width=int(zoom * width), height=int(zoom * height))
    floor = np.concatenate([xy, np.zeros((len(xy), 1))], 1)
    middles = _follow(camera.project(floor), *_bounds(camera, rows, columns, size), size)
    # Even, so that the same four rays make a pixel wherever the window is.
    corners = 2 * np.round((middles - np.array(size) / 2) / 2).astype(int)
    return Shots(camera, corners, is_whole=False)


def _bounds(
    camera: camera_lib.Camera, num_rows: int, num_columns: int, size: tuple[int, int]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Returns between which points the middle of a window stays, so that it shows little paper."""
    low, high = camera_lib.drawn_area(num_rows, num_columns)
    corners = np.array(
        [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    seen = camera.project(corners)
    room = (0.5 - _MARGIN) * np.array(size)
    least, most = seen.min(0) + room, seen.max(0) - room
    # Along an axis on which all of the maze is seen, the camera stays in its middle.
    middle = (least + most) / 2
    return np.minimum(least, middle), np.maximum(most, middle)


def _follow(
    robot: Float[np.ndarray, "F 2"],
    least: Float[np.ndarray, "2"],
    most: Float[np.ndarray, "2"],
    size: tuple[int, int],
) -> Float[np.ndarray, "F 2"]:
    """Returns the middle of the window in each frame.

    It rests while the robot is near it. When the robot comes near the edge, it glides to where the
    robot is going: what doesn't move isn't in the file again, and is easier to look at.
    """
    middle = target = np.clip(robot[0], least, most)
    middles = []
    for at in robot:
        away = at - middle
        is_far = (np.abs(away) > _ZONE * np.array(size)).any()
        if is_far and (np.abs(target - middle) < 1.0).all():
            wanted = np.clip(at + _LEAD * away, least, most)
            # At the maze's rim there may be little left to go.
            target = np.where(np.abs(wanted - middle) > 2 * _STEP, wanted, middle)
        # In two frames most often: each one in which everything moves is as large as a picture.
        rest = target - middle
        is_near = np.abs(rest) < _AT_ONCE * np.array(size)
        middle = np.where(is_near, target, middle + _GLIDE * rest)
        # Whoever moves far between two frames is kept in the picture.
        edge = (0.5 - 2 * _MARGIN) * np.array(size)
        middle = np.clip(np.clip(middle, at - edge, at + edge), least, most)
        middles.append(middle)
    return np.array(middles)
