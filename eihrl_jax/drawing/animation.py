"""Animations of a robot in a maze as GIF: the maze at a slant, and what the high level sees."""

import functools
import itertools
import pathlib
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw

from eihrl_jax import base
from eihrl_jax.drawing import palette, picture, raycast
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import kinematics

DIRECTION_NAMES = ("east", "west", "north", "south")
"""How the picture calls the subgoals x+, x-, y+, y-."""

FRAME_MILLISECONDS = 50
_LAST_FRAME_MILLISECONDS = 1800  # so that the end is seen before the loop begins anew
_MAX_FRAMES = 240  # 12 s; longer ones make files that pages load slowly
MAZE_SIZE = (560, 512)  # pixels
_PANEL_WIDTH = 208
_MARGIN = 16
_ARROW = (
    (0.75, 0.07),
    (1.45, 0.07),
    (1.45, 0.24),
    (1.95, 0.0),
    (1.45, -0.24),
    (1.45, -0.07),
    (0.75, -0.07),
)
"""Outline of the subgoal's arrow, pointing to x+ from the torso, units."""


def save(
    path: pathlib.Path,
    recording: recording_lib.Recording,
    capsules: Callable[[jax.Array], kinematics.Capsules],
    *,
    title: str,
    reach: float,
) -> None:
    """Draws an episode as GIF.

    Args:
      path: where it goes.
      recording: the episode.
      capsules: from `qpos` to the robot's geoms, see `kinematics.capsules`.
      title: what stands above the panel.
      reach: greatest distance of any part of the robot from its torso's xy, units.
    """
    frames = [
        Image.fromarray(frame) for frame in render(recording, capsules, title=title, reach=reach)
    ]

    # One palette for all frames keeps what does not move identical, and so out of the file.
    colours = _common_palette(frames)
    indexed = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    indexed[0].save(
        path,
        save_all=True,
        append_images=indexed[1:],
        duration=[FRAME_MILLISECONDS] * (len(indexed) - 1) + [_LAST_FRAME_MILLISECONDS],
        loop=0,
        optimize=False,
    )


def _common_palette(frames: list[Image.Image]) -> Image.Image:
    """Returns an image with the palette of an animation.

    It is made from a few of the frames, and from swatches of those colours that cover too little
    of them to be given a place of their own.
    """
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, 4).astype(int)]
    width, height = chosen[0].size

    montage = Image.new("RGB", (width, height * (len(chosen) + 1)))
    for i, frame in enumerate(chosen):
        montage.paste(frame, (0, i * height))

    # Shades from half to full light, as the shading makes them.
    names = (palette.GOAL, palette.GOAL_ACHIEVED, palette.ROBOT, palette.ROBOT_LIMB, palette.TRAIL)
    shades = np.linspace(0.5, 1.0, 8)
    swatches = np.array([[255 * shade * palette.rgb(name) for shade in shades] for name in names])
    swatch = Image.fromarray(swatches.astype(np.uint8))
    montage.paste(
        swatch.resize((width, height), Image.Resampling.NEAREST), (0, height * len(chosen))
    )
    # One index of 256 is left for what GIF calls transparent: pixels that stay as they were.
    return montage.quantize(255, method=Image.Quantize.MEDIANCUT)


def render(
    recording: recording_lib.Recording,
    capsules: Callable[[jax.Array], kinematics.Capsules],
    *,
    title: str,
    reach: float,
) -> Iterator[np.ndarray]:
    """Yields the pictures of an episode, uint8 [height, width, 3]; see `save`."""
    width, height = MAZE_SIZE
    backdrop = picture.draw_maze(recording.maze, width=width, height=height)
    capsules = jax.jit(capsules)

    # Long episodes skip moves; the last one is always shown.
    xy = recording.qpos[:, :2]
    visited = _visited(recording.maze, xy)
    stride = max(1, -(-len(xy) // _MAX_FRAMES))
    steps = [*range(0, len(xy) - 1, stride), len(xy) - 1]

    floor = backdrop.colour
    trail = Image.new("L", backdrop.distance.shape[::-1])
    for before, step in itertools.pairwise([0, *steps]):
        _draw_trail(trail, backdrop, xy[before : step + 1])
        decision = recording.decision[step]
        # Goals are painted anew only when one has been reached.
        if step == 0 or (visited[step] != visited[before]).any():
            floor = backdrop.colour.copy()
            _paint_goals(floor, backdrop, visited[step])

        # From the floor up: the way so far, the subgoal, the robot.
        canvas = floor.copy()
        _paint(canvas, backdrop, trail, palette.TRAIL, opacity=0.75)
        if recording.direction is not None:
            arrow = _arrow(backdrop, xy[step], int(recording.direction[decision]))
            _paint(canvas, backdrop, arrow, palette.ARROW, opacity=0.9)
        geoms = capsules(jnp.asarray(recording.qpos[step], jnp.float32))
        picture.place_robot(canvas, backdrop, geoms, reach=reach + 0.8)

        yield _with_panel(
            picture.finish(canvas), recording, step, title, num_achieved=int(visited[step].sum())
        )


def _visited(maze: maze_lib.Maze, xy: Float[np.ndarray, "T 2"]) -> Bool[np.ndarray, "T 9"]:
    """Returns for each move which goals have been visited up to then."""
    number = np.asarray(jax.vmap(functools.partial(maze_lib.goal_at, maze))(jnp.asarray(xy)))
    here = number[:, None] == np.arange(1, maze_lib.MAX_GOALS + 1)
    return np.logical_or.accumulate(here, 0)


def _pixels(backdrop: picture.Backdrop, xy: Float[np.ndarray, "N 2"]) -> list[tuple[float, float]]:
    """Returns column and row of points on the floor."""
    xyz = np.concatenate([xy, np.full((len(xy), 1), 0.02)], 1)
    image = raycast.project(backdrop.camera, jnp.asarray(xyz, jnp.float32))
    return [(float(column), float(row)) for column, row in np.asarray(image)]


def _draw_trail(
    trail: Image.Image, backdrop: picture.Backdrop, xy: Float[np.ndarray, "N 2"]
) -> None:
    """Adds a piece of the path to the trail, in place."""
    width = max(3, round(0.13 * backdrop.pixels_per_unit))
    pen = ImageDraw.Draw(trail)
    points = _pixels(backdrop, xy)
    pen.line(points, fill=255, width=width, joint="curve")
    # Round ends, where one piece of the trail joins the next.
    for column, row in points:
        r = width / 2
        pen.ellipse((column - r, row - r, column + r, row + r), fill=255)


def _arrow(backdrop: picture.Backdrop, xy: Float[np.ndarray, "2"], direction: int) -> Image.Image:
    """Returns the mask of the arrow of the current subgoal."""
    cos, sin = base.DIRECTIONS_XY[direction]
    outline = xy + np.array(_ARROW) @ np.array([[cos, sin], [-sin, cos]])
    mask = Image.new("L", backdrop.distance.shape[::-1])
    ImageDraw.Draw(mask).polygon(_pixels(backdrop, outline), fill=255)
    return mask


def _paint(
    canvas: Float[np.ndarray, "H W 3"],
    backdrop: picture.Backdrop,
    mask: Image.Image,
    colour: str,
    *,
    opacity: float,
) -> None:
    """Lays a colour over the floor where the mask is set, in place; walls hide it."""
    where = np.nonzero(backdrop.is_floor & (np.asarray(mask) > 0))
    canvas[where] = (1.0 - opacity) * canvas[where] + opacity * palette.rgb(colour)


def _paint_goals(
    canvas: Float[np.ndarray, "H W 3"],
    backdrop: picture.Backdrop,
    visited: Bool[np.ndarray, "9"],
) -> None:
    """Colours the goal regions, in place."""
    for number in np.unique(backdrop.goal[backdrop.goal > 0]):
        colour = palette.GOAL_ACHIEVED if visited[number - 1] else palette.GOAL
        where = backdrop.goal == number
        # Multiplying keeps the shadows on the floor.
        canvas[where] *= palette.rgb(colour) / palette.rgb(palette.FLOOR)


def _with_panel(
    image: np.ndarray,
    recording: recording_lib.Recording,
    step: int,
    title: str,
    *,
    num_achieved: int,
) -> np.ndarray:
    """Puts the panel beside a finished picture: numbers, subgoal, patch."""
    height, width = image.shape[:2]
    page = Image.new("RGB", (width + _PANEL_WIDTH, height), palette.PAPER)
    page.paste(Image.fromarray(image), (0, 0))
    pen = ImageDraw.Draw(page)
    left, top = width + 4, 40

    decision = int(recording.decision[step])
    limit, total = int(recording.maze.num_decisions), int(recording.maze.num_goals)
    goal_colour = palette.GOAL_ACHIEVED if num_achieved == total else palette.INK
    pen.text((left, top), title, palette.INK, palette.font(18, is_bold=True))

    # Name, value, where they stand, and the value's colour.
    numbers = [
        ("decision", f"{decision + 1} of {limit}", 0, 40, palette.INK),
        ("goals", f"{num_achieved} of {total}", 116, 40, goal_colour),
    ]
    if recording.direction is not None:
        direction = DIRECTION_NAMES[int(recording.direction[decision])]
        numbers.append(("subgoal", direction, 0, 96, palette.ARROW))

    for name, value, x, y, colour in numbers:
        pen.text((left + x, top + y), name, palette.MUTED, palette.font(13))
        pen.text((left + x, top + y + 18), value, colour, palette.font(18, is_bold=True))
    if recording.is_fallen[step]:
        pen.text((left + 116, top + 114), "fallen", palette.ROBOT, palette.font(18, is_bold=True))

    if recording.patch is not None:
        pen.text((left, top + 152), "what the high level sees", palette.MUTED, palette.font(13))
        side = _PANEL_WIDTH - _MARGIN - 4
        page.paste(_patch_picture(recording.patch[decision], side), (left, top + 172))
    return np.asarray(page)


def _patch_picture(patch: Bool[np.ndarray, "P P C"], side: int) -> Image.Image:
    """Draws a patch: walls, goals and robot in the colours of the large picture."""
    small = Image.fromarray(np.round(255 * picture.colour_patch(patch)).astype(np.uint8))
    large = small.resize((side, side), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(large)
    for i in range(1, len(patch)):
        at = round(i * side / len(patch))
        pen.line([(at, 0), (at, side)], palette.PAPER)
        pen.line([(0, at), (side, at)], palette.PAPER)
    return large
