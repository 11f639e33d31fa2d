"""A maze without robot, as a camera sees it: drawn tile by tile, wherever somebody looks.

Walls fill cells and are low and equally high. So a ray that comes down through the height of the
walls crosses at most one border of cells in x and one in y, and what it meets is looked up: a pixel
costs the same in a maze of any size.
"""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eihrl_jax import base
from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import palette
from eihrl_jax.mazes import maze as maze_lib

LIGHT = (-0.48, -0.28, 0.83)
"""Unit vector towards the light: from the left, a little from the front."""

SHADOW = 0.30
"""Share of the floor's colour that a shadow takes."""

_AMBIENT = 0.60  # share of the light that comes from everywhere
_TILE = 256  # pixels along a side: what is computed of it stays in a processor's cache
_MAX_TILES = 512  # that are kept, 300 MB
_NEVER = 2.0  # beyond the end of a segment, whose parts lie in [0, 1]


class Region(NamedTuple):
    """A rectangle of the picture of a maze.

    Attributes:
      colour: uint8 [H, W, 3].
      distance: float32 [H, W], from the camera to what is seen, units.
      goal: int8 [H, W], number of the goal region on whose floor a pixel lies, 0 elsewhere.
      is_floor: bool [H, W], pixels of the floor inside the maze.
    """

    colour: UInt8[np.ndarray, "H W 3"]
    distance: Float[np.ndarray, "H W"]
    goal: Int[np.ndarray, "H W"]
    is_floor: Bool[np.ndarray, "H W"]

    def paint_goals(self, visited: Bool[np.ndarray, "9"]) -> None:
        """Colours the goal regions, in place."""
        for number in np.unique(self.goal[self.goal > 0]):
            colour = palette.GOAL_ACHIEVED if visited[number - 1] else palette.GOAL
            # Multiplying keeps the shadows on the floor.
            tint = palette.rgb(colour) / palette.rgb(palette.FLOOR)
            where = self.goal == number
            self.colour[where] = (self.colour[where] * tint).clip(0, 255)


class _Grid(NamedTuple):
    """Cells along one axis, numbered from 1; 0 and the last lie outside of what is drawn.

    Attributes:
      low: where what is drawn begins, units.
      high: where it ends.
      num: of cells.
    """

    low: float
    high: float
    num: int

    def cell(self, at: Float[np.ndarray, "H W"]) -> Int[np.ndarray, "H W"]:
        """Returns the cells of some places."""
        number = np.floor(at / base.CELL).astype(np.int32) + 1
        number = np.clip(number, 1, self.num)
        return np.where(at < self.low, 0, np.where(at >= self.high, self.num + 1, number))

    def border(self, cell: Int[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
        """Returns where cells begin, units."""
        lines = np.arange(-1.0, self.num + 1) * base.CELL
        lines[1], lines[-1] = self.low, self.high
        return lines.astype(np.float32)[cell]


class _Met(NamedTuple):
    """What segments meet first.

    Attributes:
      part: share of each after which it enters a wall, `_NEVER` where it doesn't.
      is_x: whether it does so through a face across x.
    """

    part: Float[np.ndarray, "H W"]
    is_x: Bool[np.ndarray, "H W"]


@dataclasses.dataclass(frozen=True, eq=False)
class Scenery:
    """A maze whose door has been drawn, seen by a camera.

    Attributes:
      maze: the maze.
      camera: who sees it.
    """

    maze: maze_lib.Maze
    camera: camera_lib.Camera

    @property
    def pixels_per_unit(self) -> float:
        """Scale at the maze's centre."""
        return camera_lib.pixels_per_unit(self.camera, *self.maze.wall.shape)

    def region(self, corner: Int[np.ndarray, "2"], *, width: int, height: int) -> Region:
        """Returns a rectangle of the picture, as a copy.

        Args:
          corner: its first column and row.
          width: of the rectangle, pixels.
          height: of the rectangle, pixels.
        """
        out = Region(
            np.empty((height, width, 3), np.uint8),
            np.empty((height, width), np.float32),
            np.empty((height, width), np.int8),
            np.empty((height, width), bool),
        )
        left, top = corner.tolist()
        for row in range(top // _TILE, -(-(top + height) // _TILE)):
            for column in range(left // _TILE, -(-(left + width) // _TILE)):
                tile = self._tiles(row, column)
                # What of the tile lies in the rectangle, in the coordinates of both.
                y, x = row * _TILE, column * _TILE
                y0, y1 = max(y, top), min(y + _TILE, top + height)
                x0, x1 = max(x, left), min(x + _TILE, left + width)
                for whole, part in zip(out, tile, strict=True):
                    inside = part[y0 - y : y1 - y, x0 - x : x1 - x]
                    whole[y0 - top : y1 - top, x0 - left : x1 - left] = inside
        return out

    @functools.cached_property
    def _tiles(self) -> "functools._lru_cache_wrapper[Region]":
        return functools.lru_cache(_MAX_TILES)(self._draw)

    @functools.cached_property
    def _grids(self) -> tuple[_Grid, _Grid]:
        """Cells along x, and along the rows: against y."""
        rows, columns = self.maze.wall.shape
        low, high = camera_lib.drawn_area(rows, columns)
        return (
            _Grid(float(low[0]), float(high[0]), columns),
            _Grid(-float(high[1]), -float(low[1]), rows),
        )

    @functools.cached_property
    def _cells(self) -> tuple[Bool[np.ndarray, "R C"], Int[np.ndarray, "R C"]]:
        """Walls and goals, with a rim of what lies outside."""
        return np.pad(np.asarray(self.maze.wall), 1), np.pad(np.asarray(self.maze.goal), 1)

    def _draw(self, row: int, column: int) -> Region:
        """Draws a tile."""
        corner = np.array([column, row]) * _TILE
        direction = self.camera.rays(corner, height=_TILE, width=_TILE)
        position = self.camera.position.astype(np.float32)
        across, down = self._grids
        wall, goal = self._cells

        # From the height of the walls to the floor: x, and y southwards as rows count.
        at_top = (camera_lib.WALL_HEIGHT - position[2]) / direction[2]
        at_floor = -position[2] / direction[2]
        top = [sign * (position[i] + at_top * direction[i]) for i, sign in ((0, 1), (1, -1))]
        floor = [sign * (position[i] + at_floor * direction[i]) for i, sign in ((0, 1), (1, -1))]
        is_top = wall[down.cell(top[1]), across.cell(top[0])]
        met = self._first_wall(top, floor)
        is_side = (met.part <= 1.0) & ~is_top

        # The place that is seen, the height of which falls evenly along the segment.
        part = np.where(is_top, 0.0, np.minimum(met.part, 1.0)).astype(np.float32)
        x, y = (start + part * (end - start) for start, end in zip(top, floor, strict=True))
        height = camera_lib.WALL_HEIGHT * (1.0 - part)
        i, j = down.cell(floor[1]), across.cell(floor[0])
        is_inside = (i > 0) & (i <= down.num) & (j > 0) & (j <= across.num)
        is_floor = ~is_top & ~is_side & is_inside

        # Faces look against the ray that meets them; all else looks up.
        normal = [
            np.where(is_side & (met.is_x == (axis == 0)), -np.sign(floor[axis] - top[axis]), 0.0)
            for axis in (0, 1)
        ]
        shade = self._shade((x, y), height, normal, is_side)
        shade *= np.where(is_floor, self._crevice((x, y), (i, j)), 1.0)

        tile = np.where(
            ((i + j) % 2 == 0)[..., None],
            palette.rgb(palette.FLOOR),
            palette.rgb(palette.FLOOR_ALTERNATE),
        )
        surface = np.where(is_floor[..., None], tile, palette.rgb(palette.WALL))
        is_seen = is_top | is_side | is_floor
        colour = np.where(
            is_seen[..., None], surface * shade[..., None], palette.rgb(palette.PAPER)
        )
        return Region(
            (255.0 * colour.clip(0.0, 1.0) + 0.5).astype(np.uint8),
            (at_top + part * (at_floor - at_top)).astype(np.float32),
            np.where(is_floor, goal[i, j], 0).astype(np.int8),
            is_floor,
        )

    def _first_wall(self, start: list[np.ndarray], end: list[np.ndarray]) -> _Met:
        """Returns where segments between places, x and y southwards, enter a wall first."""
        wall, _ = self._cells
        parts, cells = [], []
        for grid, one, other in zip(self._grids, start, end, strict=True):
            before, after = grid.cell(one), grid.cell(other)
            # The border is where the further one of both cells begins.
            line = grid.border(np.maximum(before, after))
            way = np.where(before == after, 1.0, other - one)
            parts.append(np.where(before == after, _NEVER, (line - one) / way))
            cells.append((before, after))

        # After the first border the segment is in the new cell along one axis alone.
        (j0, j1), (i0, i1) = cells
        is_x_first = parts[0] < parts[1]
        first, second = np.minimum(*parts), np.maximum(*parts)
        is_first = np.where(is_x_first, wall[i0, j1], wall[i1, j0]) & (first <= 1.0)
        is_second = wall[i1, j1] & (second <= 1.0)
        part = np.where(is_first, first, np.where(is_second, second, _NEVER))
        return _Met(part.astype(np.float32), is_x_first == is_first)

    def _shade(
        self,
        place: tuple[np.ndarray, np.ndarray],
        height: Float[np.ndarray, "H W"],
        normal: list[np.ndarray],
        is_side: Bool[np.ndarray, "H W"],
    ) -> Float[np.ndarray, "H W"]:
        """Returns the share of its colour that each place shows: diffuse light with shadows."""
        light = (LIGHT[0], -LIGHT[1], LIGHT[2])  # southwards, as rows count
        # Off the face, so that a wall doesn't shade itself.
        start = [at + 1e-3 * out for at, out in zip(place, normal, strict=True)]
        rise = np.maximum(camera_lib.WALL_HEIGHT - height, 0.0) / light[2]
        end = [at + rise * towards for at, towards in zip(start, light[:2], strict=True)]
        is_dark = self._first_wall(start, end).part <= 1.0

        lambert = normal[0] * light[0] + normal[1] * light[1] + np.where(is_side, 0.0, light[2])
        lambert = np.maximum(lambert, 0.0) * np.where(is_dark, 1.0 - 2.0 * SHADOW, 1.0)
        return _AMBIENT + (1.0 - _AMBIENT) * lambert / light[2]

    def _crevice(
        self, place: tuple[np.ndarray, np.ndarray], cell: tuple[np.ndarray, np.ndarray]
    ) -> Float[np.ndarray, "H W"]:
        """Returns how light the floor is at the foot of the walls around it, in [0, 1]."""
        wall, _ = self._cells
        (x, y), (i, j) = place, cell
        across, down = self._grids
        i, j = np.clip(i, 1, down.num), np.clip(j, 1, across.num)
        gaps_x = (x - across.border(j), np.float32(0.0), across.border(j + 1) - x)
        gaps_y = (y - down.border(i), np.float32(0.0), down.border(i + 1) - y)

        # Walls farther than the next cell are too far to darken anything.
        nearest = np.full(x.shape, base.CELL**2, np.float32)
        for di, gap_y in enumerate(gaps_y, -1):
            for dj, gap_x in enumerate(gaps_x, -1):
                apart = np.where(wall[i + di, j + dj], gap_x**2 + gap_y**2, base.CELL**2)
                nearest = np.minimum(nearest, apart)
        return 1.0 - 0.28 * np.exp(-np.sqrt(nearest) / 0.55)
