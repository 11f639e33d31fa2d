"""A pinhole camera above a maze: where points of the world are in a picture, and back. NumPy only.

World coordinates are units with z up and the floor at z = 0. A picture has row 0 at the top.
"""

import dataclasses
import itertools
import math

import numpy as np
from jaxtyping import Float, Int

from eihrl_jax import base

WALL_HEIGHT = 1.1
"""Drawn height of the walls, units: lower than they are, so that they hide little."""

RING = 1.5
"""Drawn thickness of the outer ring, units; the rest of it is cut off."""

PITCH = math.radians(62.0)
"""Angle of the optical axis below the horizon."""

_FIELD = 3.2
"""Distance of the camera in widths of the maze: the larger, the weaker the perspective."""


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
      position: where it is, units.
      axes: unit vectors to the right, down and forward in the picture, as rows.
      focal: pixels per unit of image plane at distance 1.
      centre: pixel column and row of the optical axis.
    """

    position: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]
    focal: float
    centre: Float[np.ndarray, "2"]

    def project(self, xyz: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
        """Returns pixel column and row of points in front of the camera."""
        x, y, depth = ((xyz - self.position) @ self.axes.T).T
        return self.centre + self.focal * np.stack([x, y], -1) / depth[:, None]

    def rays(
        self, corner: Int[np.ndarray, "2"], *, height: int, width: int
    ) -> Float[np.ndarray, "3 H W"]:
        """Returns the unit directions of the pixels of a window.

        Args:
          corner: column and row of the window's first pixel, top left.
          height: rows of the window, H.
          width: columns of the window, W.
        """
        # Through the middle of each pixel.
        right = (np.arange(width) + 0.5 + corner[0] - self.centre[0]) / self.focal
        down = (np.arange(height) + 0.5 + corner[1] - self.centre[1]) / self.focal
        right, down = right.astype(np.float32)[None], down.astype(np.float32)[:, None]
        scale = 1.0 / np.sqrt(1.0 + right**2 + down**2)
        axes = self.axes.astype(np.float32)
        return np.stack(
            [(axes[0, i] * right + axes[1, i] * down + axes[2, i]) * scale for i in range(3)]
        )


def look_at(
    position: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
    focal: float,
    centre: Float[np.ndarray, "2"],
) -> Camera:
    """Returns a camera at `position` whose optical axis goes through `target`, upright."""
    # Image axes are x right, y down, z forward, so that depth is the third coordinate.
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    return Camera(position, np.stack([right, np.cross(forward, right), forward]), focal, centre)


def drawn_area(
    num_rows: int, num_columns: int
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Returns lower and upper corner of what is drawn of a maze, units; see `RING`."""
    cut = base.CELL - RING
    low = np.array([cut, cut - num_rows * base.CELL, 0.0])
    high = np.array([num_columns * base.CELL - cut, -cut, WALL_HEIGHT])
    return low, high


def fit(num_rows: int, num_columns: int, *, width: int, height: int) -> Camera:
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
    unit = look_at(centre + _FIELD * size.max() * back, centre, 1.0, np.zeros(2))

    # ... tells how large the maze is in its picture, which then fills the frame.
    corner = np.array(list(itertools.product(*np.stack([low, high], -1))))
    image = unit.project(corner)
    low, high = image.min(0), image.max(0)
    focal = 0.97 * min(width / (high - low)[0], height / (high - low)[1])
    middle = np.array([width, height]) / 2 - focal * (low + high) / 2
    return dataclasses.replace(unit, focal=float(focal), centre=middle)


def pixels_per_unit(camera: Camera, num_rows: int, num_columns: int) -> float:
    """Returns the scale at the middle of a maze."""
    # A focal length over a depth is pixels per unit there.
    middle = np.mean(drawn_area(num_rows, num_columns), 0)
    return camera.focal / float(np.linalg.norm(camera.position - middle))
