"""Options of reading a maze from a file of another kind, see `docs/mazes.md`."""

from typing import Annotated, Literal

from eihrl_jax.config import limits

Place = tuple[float, float]
"""Row and column counted from 1, or x and y in metres."""


@limits.dataclass
class ReadingConfig:
    """What a maze's file leaves open.

    Attributes:
      start: row and column of the only start, counted from 1 as in the file; none: as in the file.
      goal: row and column of the only goal; none: as in the file.
      places: what start and goal are: row and column of a cell, or x and y in metres from the lower
        left corner of a picture, of a ROS map in its own frame.
      transposed: of lists, rows of the file are columns of the maze, as in JaxGCRL, mirrored.
      scenario: of a MovingAI scenario file, which of its lines, counted from 1; 0: the last one.
      metres_per_pixel: of a picture; a ROS map has its own. 0: unknown, a pixel is a cell.
      cell_metres: side of a cell of a map or picture whose metres per pixel are known.
      robot_radius: metres by which the obstacles of a map or picture grow.
      occupied: darkness of a pixel in [0, 1] above which it is an obstacle; none: 0.65, of a ROS
        map its own occupied_thresh.
      free: darkness below which it is free; none: 0.196, of a ROS map its own free_thresh.
      unknown: what is taken for a pixel between the two, or a transparent one.
    """

    start: Place | None = None
    goal: Place | None = None
    places: Literal["cells", "metres"] = "cells"
    transposed: bool = False
    scenario: Annotated[int, limits.Range(0, 10_000_000)] = 0
    metres_per_pixel: Annotated[float, limits.Range(0.0, 1_000.0)] = 0.0
    cell_metres: Annotated[float, limits.Range(above=0.0, high=1_000.0)] = 0.5
    robot_radius: Annotated[float, limits.Range(0.0, 1_000.0)] = 0.0
    occupied: limits.Fraction | None = None
    free: limits.Fraction | None = None
    unknown: Literal["wall", "free"] = "wall"
