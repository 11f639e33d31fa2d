"""Plans of mazes and the high level's patches, drawn to scale into given matplotlib axes."""

from typing import Any

import matplotlib.axes
import matplotlib.patches
import numpy as np
from jaxtyping import Bool, Int

from eihrl_jax import base
from eihrl_jax.drawing import figures, palette, picture
from eihrl_jax.envs import raster
from eihrl_jax.mazes import maze as maze_lib

_DOOR_OPACITY = 0.35


def extent(maze: maze_lib.Maze) -> tuple[float, float, float, float]:
    """Returns the sides of a maze as matplotlib's `extent`: left, right, bottom, top, in units."""
    rows, columns = maze.wall.shape
    return 0.0, columns * base.CELL, -rows * base.CELL, 0.0


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


def draw(axes: matplotlib.axes.Axes, maze: maze_lib.Maze, *, title: str = "") -> None:
    """Draws the plan of a maze: tiles of one cell, walls, numbered goals, door candidates, starts.

    Args:
      axes: where to; gets the maze's size and labels in units.
      maze: one maze. Door candidates that are not open are tinted.
      title: what stands above it.
    """
    tile = np.indices(maze.wall.shape).sum(0) % 2 == 0
    image = np.where(
        tile[..., None], palette.rgb(palette.FLOOR), palette.rgb(palette.FLOOR_ALTERNATE)
    )
    goal, gold = np.asarray(maze.goal), palette.rgb(palette.GOAL)
    image[goal > 0] = gold

    # Door candidates that are walled up show as wall with a tint of gold.
    closed = np.asarray(maze.door & maze.wall)
    wall = palette.rgb(palette.WALL)
    image[closed] = (1.0 - _DOOR_OPACITY) * wall + _DOOR_OPACITY * gold
    axes.imshow(image, extent=extent(maze), interpolation="nearest")

    add_marks(axes, maze, start_colour=palette.INK)
    # A region's number stands once, in the middle of its cells or in one of them.
    places = maze_lib.goal_places(goal)
    for number in np.unique(goal[goal > 0]):
        x, y = places[number - 1][0]
        axes.text(x, y, str(number), ha="center", va="center", color=palette.INK, weight="bold")
    figures.label(axes, "x, units", "y, units")
    axes.set_title(title, loc="left", color=palette.INK, fontsize=10)


def add_marks(axes: matplotlib.axes.Axes, maze: maze_lib.Maze, *, start_colour: str) -> None:
    """Adds walls, outlines of doors and goals, and starts to what is drawn of a maze to scale.

    Args:
      axes: where to; gets the maze's size.
      maze: one maze.
      start_colour: of the circles around starts; a room that starts anywhere gets none.
    """
    # One rectangle for many cells: neighbours drawn apart would show seams.
    door = np.asarray(maze.door)
    for cells in wall_rectangles(np.asarray(maze.wall) & ~door):
        _add_rectangle(axes, cells, facecolor=palette.WALL, edgecolor=palette.WALL)
    for i, j in np.argwhere(door):
        cell = np.array([i, j, i + 1, j + 1])
        _add_rectangle(axes, cell, facecolor="none", edgecolor=palette.GOAL, linewidth=0.5)

    goal = np.asarray(maze.goal)
    for number in range(1, int(goal.max()) + 1):
        for cells in wall_rectangles(goal == number):
            _add_rectangle(axes, cells, facecolor="none", edgecolor=palette.GOAL, linewidth=2)

    # A room where every cell is a start would be full of circles.
    starts = np.argwhere(np.asarray(maze.start))
    if len(starts) <= maze_lib.MAX_GOALS:
        x, y = (starts[:, 1] + 0.5) * base.CELL, -(starts[:, 0] + 0.5) * base.CELL
        axes.plot(x, y, "o", markerfacecolor="none", markeredgecolor=start_colour, markersize=9)

    left, right, bottom, top = extent(maze)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    axes.spines[:].set_visible(False)
    axes.tick_params(colors=palette.INK)


def draw_patch(
    axes: matplotlib.axes.Axes,
    patch: Bool[np.ndarray, "P P C"],
    view: raster.View,
    *,
    title: str = "",
) -> None:
    """Draws what a high level sees, its three channels in one picture.

    Args:
      axes: where to; gets the view's size and labels in units from the torso.
      patch: channels wall, unvisited goal, robot; see `raster.draw`.
      view: extent and resolution of the patch.
      title: what stands above it.
    """
    half = view.extent / 2
    sides = (-half, half, -half, half)
    axes.imshow(picture.colour_patch(patch), extent=sides, interpolation="nearest")

    # Lines between pixels: the network sees squares, not shapes.
    edges = np.linspace(-half, half, view.pixels + 1)
    style = {"color": palette.PAPER, "linewidth": 0.5}
    axes.hlines(edges, -half, half, **style)
    axes.vlines(edges, -half, half, **style)

    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.spines[:].set_visible(False)
    figures.label(axes, "x from the torso, units", "y from the torso, units")
    axes.set_title(title, loc="left", color=palette.INK, fontsize=10)


def _add_rectangle(axes: matplotlib.axes.Axes, cells: Int[np.ndarray, "4"], **style: Any) -> None:
    """Adds a rectangle of cells: first row and column, last row and column + 1."""
    i0, j0, i1, j1 = (base.CELL * n for n in cells)
    axes.add_patch(matplotlib.patches.Rectangle((j0, -i1), j1 - j0, i1 - i0, **style))
