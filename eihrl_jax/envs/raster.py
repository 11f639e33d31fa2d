"""What the high level sees: a top view of the maze around the robot, as pixels (paper, Sec. 3.2).

The patch is centred on the torso with north up: row 0 has the largest y, column 0 the smallest x.
A pixel is wall or goal if its centre is. The silhouette is drawn so that no part of the robot is
too thin to be seen, see `footprint`.

A view may show a map instead: one pixel per cell, of all that has been in sight since the episode
began (ours, not the paper's).

A patch is drawn thousands of times per decision of the learner, so cells and silhouettes are packed
into the bits of integers: one word per pixel row, one mask per pixel column, and a pixel is `word &
mask`. On CPU this is several times as fast as looking up the cell of every pixel.
"""

import dataclasses
import math
from typing import Annotated, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from eihrl_jax import base
from eihrl_jax.config import limits
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import kinematics

_WORD = 32  # bits
_GOAL_SHIFT = 16  # a row's walls are in the lower half of its word, its goals in the upper half

Picture: TypeAlias = Bool[Array, "n m C"]
"""A square patch of pixels, or a map of cells, see `View.obs_shape`."""

WHOLE_MARGIN = 8
"""Cells by which a map of a whole maze extends beyond it, so that the border isn't shown."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """The square patch or the map that the high level sees.

    Attributes:
      extent: side in units, 3 to 45.
      pixels: side in pixels, 3 to 128.
      map_radius: cells to every side of the robot's cell on a map, which is shown instead of the
        patch, up to 300; 0: no map.
      map_shape: rows and columns of the largest maze, for a map of whole mazes; None: the map is
        around the robot.
      knows: what is on the map from the start: "nothing", the cells of the "goal", or the whole
        "map".

    Raises:
      base.UserError: out of these limits, or `knows` is given without a map.
    """

    # The cells of one row have to fit into half a word.
    extent: Annotated[float, limits.Range(base.CELL, 15 * base.CELL)] = 9.0
    pixels: Annotated[int, limits.Range(3, 128)] = 15
    map_radius: Annotated[int, limits.Range(0, 300)] = 0
    map_shape: tuple[int, int] | None = None
    knows: base.Knows = "nothing"

    def __post_init__(self) -> None:
        """Checks the limits."""
        limits.check(self, "view ")
        if self.knows != "nothing" and not self.has_map:
            raise base.UserError(f"knows = {self.knows!r} needs a map, but map_radius = 0")

    @property
    def has_map(self) -> bool:
        """Whether a map is shown."""
        return self.map_radius > 0 or self.map_shape is not None

    @property
    def obs_shape(self) -> tuple[int, int, int]:
        """Shape of what the high level gets: a patch, or a map with one channel more."""
        if self.map_shape is not None:
            rows, columns = self.map_shape
            return rows + 2 * self.margin, columns + 2 * self.margin, 4
        if self.map_radius > 0:
            return 2 * self.map_radius + 1, 2 * self.map_radius + 1, 4
        return self.pixels, self.pixels, 3

    @property
    def margin(self) -> int:
        """Cells around a grid that looking at it needs."""
        return max(1, self.map_radius) if self.map_shape is None else WHOLE_MARGIN

    @property
    def pitch(self) -> float:
        """Side of a pixel in units."""
        return self.extent / self.pixels

    @property
    def num_cells(self) -> int:
        """Greatest number of cells that one row of pixels can cross."""
        return math.ceil(self.extent / base.CELL) + 1

    @property
    def num_words(self) -> int:
        """Number of words that hold one row of a silhouette."""
        return -(-self.pixels // _WORD)

    def covering(self, rows: int, columns: int) -> "View":
        """Returns this view with a map of whole mazes of up to so many rows and columns.

        Such a map has up to a quarter of the cells that one around the robot would need.
        """
        return dataclasses.replace(self, map_radius=0, map_shape=(rows, columns))

    def offsets(self) -> np.ndarray:
        """Returns the pixel centres' distances from the torso, in units, ascending; [P] float32."""
        centred = np.arange(self.pixels) + 0.5 - self.pixels / 2
        return (centred * self.pitch).astype(np.float32)


def footprint(
    capsules: kinematics.Capsules, torso_xy: Float[Array, "2"], view: View
) -> Bool[Array, "P P"]:
    """Draws a robot's silhouette from its capsules seen from above, the torso in the middle.

    A pixel is drawn where a capsule touches the disc inscribed in it, so that a leg thinner than a
    pixel leaves a line without gaps.

    Args:
      capsules: the robot's geoms, units.
      torso_xy: the torso's position, units.
      view: extent and resolution.
    """
    start, end, radius = capsules
    start_xy, end_xy = start[:, :2] - torso_xy[None], end[:, :2] - torso_xy[None]
    offsets = jnp.asarray(view.offsets())
    pixel_xy = jnp.stack(jnp.meshgrid(offsets, -offsets), -1)[:, :, None]

    # The distance of every pixel from the nearest point of every capsule's axis.
    axis = (end_xy - start_xy)[None, None]
    from_start = pixel_xy - start_xy[None, None]
    along = (from_start * axis).sum(-1) / jnp.maximum((axis**2).sum(-1), 1e-12)
    nearest = jnp.clip(along, 0.0, 1.0)[..., None] * axis
    distance = jnp.sqrt(((from_start - nearest) ** 2).sum(-1))

    # Half a pixel more than the capsule itself, or thin legs would fall between pixel centres.
    return (distance <= radius[None, None] + view.pitch / 2).any(-1)


def pack(silhouette: Bool[Array, "P P"], view: View) -> UInt32[Array, "P W"]:
    """Packs a silhouette into words, the first pixel of a row in the lowest bit of its first."""
    margin = view.num_words * _WORD - view.pixels
    padded = jnp.pad(silhouette, ((0, 0), (0, margin))).reshape(view.pixels, -1, _WORD)
    return _pack_bits(padded)


def window(xy: Float[Array, "2"], view: View) -> tuple[Int[Array, "n 1"], Int[Array, "1 n"]]:
    """Returns the rows and columns of the square of cells that the view at `xy` shows."""
    i, j = _pixel_cells(xy, view)
    span = jnp.arange(view.num_cells)
    return (i[:1] + span)[:, None], (j[:1] + span)[None]


def draw(
    codes: UInt8[Array, "n n"],
    xy: Float[Array, "2"],
    visited: Bool[Array, "9"],
    silhouette: UInt32[Array, "P W"],
    view: View,
) -> Bool[Array, "P P 3"]:
    """Draws the patch from what the cells of `window` hold.

    Args:
      codes: codes (see `mazes.maze.codes`) of the cells of the window.
      xy: the torso's position, units.
      visited: goals that have been visited; they are no longer drawn.
      silhouette: the robot, packed.
      view: extent and resolution.

    Returns:
      Channels wall, unvisited goal, robot.
    """
    walls = _pack_bits(codes == maze_lib.WALL)
    goals = _pack_bits(_is_unvisited(codes, visited))

    # One word per pixel row and one mask per pixel column. Gathers also keep XLA from computing
    # words and masks anew for every pixel.
    i, j = _pixel_cells(xy, view)
    cells = (walls | goals << _GOAL_SHIFT).at[i - i[:1]].get(mode="promise_in_bounds")
    wall_mask = jnp.asarray(_single_bits(_WORD)).at[j - j[:1]].get(mode="promise_in_bounds")

    # The silhouette is packed by pixels instead of cells; its own words repeat along a row.
    robot_mask = np.tile(_single_bits(_WORD), view.num_words)[: view.pixels]
    robot = jnp.repeat(silhouette, _WORD, axis=1)[:, : view.pixels]

    # Each channel masks only what it shows, so that one comparison makes all three.
    nothing = jnp.zeros_like(wall_mask)
    cell_masks = jnp.stack([wall_mask, wall_mask << _GOAL_SHIFT, nothing], -1)
    robot_masks = jnp.stack([nothing, nothing, jnp.asarray(robot_mask)], -1)
    pixels = cells[:, None, None] & cell_masks[None]
    return (pixels | robot[:, :, None] & robot_masks[None]) > 0


def in_sight(
    shape: tuple[int, int], margin: int, xy: Float[Array, "2"], view: View
) -> Bool[Array, "H W"]:
    """Returns which cells of a grid the square at `xy` touches.

    Args:
      shape: of the grid, its margin included.
      margin: rows and columns that the grid has before the maze's first.
      xy: the torso's position, units.
      view: whose `extent` is looked at.
    """
    # In the order row, column; rows grow downwards, y upwards.
    centre, reach = jnp.stack([-xy[1], xy[0]]), view.extent / 2
    first = jnp.floor((centre - reach) / base.CELL).astype(jnp.int32)
    end = jnp.ceil((centre + reach) / base.CELL).astype(jnp.int32)
    i, j = (jnp.arange(size) - margin for size in shape)
    is_row, is_column = (i >= first[0]) & (i < end[0]), (j >= first[1]) & (j < end[1])
    return is_row[:, None] & is_column[None]


def draw_map(
    codes: UInt8[Array, "n m"],
    seen: Bool[Array, "n m"],
    visited: Bool[Array, "9"],
    robot_ij: Int[Array, "2"],
) -> Bool[Array, "n m 4"]:
    """Draws the map: one pixel per cell, north up.

    Args:
      codes: codes (see `mazes.maze.codes`) of the cells.
      seen: cells that have been in sight, or are known.
      visited: goals that have been visited; they are no longer drawn.
      robot_ij: row and column of the robot's cell on the map.

    Returns:
      Channels wall, unvisited goal, robot, and what hasn't been seen.
    """
    goal = seen & _is_unvisited(codes, visited)
    i, j = (jnp.arange(size) for size in codes.shape)
    robot = (i == robot_ij[0])[:, None] & (j == robot_ij[1])[None]
    return jnp.stack([seen & (codes == maze_lib.WALL), goal, robot, ~seen], -1)


def _is_unvisited(codes: UInt8[Array, "*k"], visited: Bool[Array, "9"]) -> Bool[Array, "*k"]:
    """Returns which cells belong to an unvisited goal."""
    unvisited = _pack_bits(~visited) << 1  # bit g for goal g, bit 0 for cells without goal
    return ((unvisited >> (codes % maze_lib.WALL).astype(jnp.uint32)) & 1).astype(bool)


def _pixel_cells(xy: Float[Array, "2"], view: View) -> tuple[Int[Array, "P"], Int[Array, "P"]]:
    """Returns the row of each pixel row and the column of each pixel column."""
    # Ascending offsets serve as distances to the south for rows and to the east for columns.
    offsets = jnp.asarray(view.offsets())
    i = jnp.floor((offsets - xy[1]) / base.CELL).astype(jnp.int32)
    j = jnp.floor((offsets + xy[0]) / base.CELL).astype(jnp.int32)
    return i, j


def _single_bits(num: int) -> np.ndarray:
    """Returns the words in which only bit 0, 1, ... is set."""
    return np.left_shift(np.uint32(1), np.arange(num, dtype=np.uint32))


def _pack_bits(bits: Bool[Array, "*k n"]) -> UInt32[Array, "*k"]:
    """Packs the last axis into the bits of a word, the first in the lowest bit."""
    weights = jnp.broadcast_to(_single_bits(bits.shape[-1]), bits.shape)
    return jnp.where(bits, weights, jnp.uint32(0)).sum(-1, dtype=jnp.uint32)
