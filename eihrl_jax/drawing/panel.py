"""The panel beside the maze of an animation: numbers, subgoal, what the high level sees, a plan."""

import functools

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw

from eihrl_jax import base
from eihrl_jax.drawing import palette, picture
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.mazes import maze as maze_lib

DIRECTION_NAMES = ("east", "west", "north", "south")
"""How the picture calls the subgoals x+, x-, y+, y-."""

WIDTH = 208
_LEFT, _TOP = 4, 40
_SIDE = 188  # of the picture of the patch
_PLAN_TOP, _PLAN_HEIGHT = 412, 84
_font = functools.cache(palette.font)


def draw(
    recording: recording_lib.Recording,
    title: str,
    height: int,
    *,
    decision: int,
    num_achieved: int,
    is_fallen: bool,
) -> Image.Image:
    """Returns the panel during a decision, without the robot on the plan.

    Args:
      recording: the episode.
      title: what stands above it.
      height: of the panel, pixels.
      decision: index of the decision.
      num_achieved: goals reached so far.
      is_fallen: whether the robot lies on the ground.
    """
    panel = Image.new("RGB", (WIDTH, height), palette.PAPER)
    pen = ImageDraw.Draw(panel)
    limit, total = int(recording.maze.num_decisions), int(recording.maze.num_goals)
    goal_colour = palette.GOAL_ACHIEVED if num_achieved == total else palette.INK
    pen.text((_LEFT, _TOP), base.printable(title), palette.INK, _font(18, is_bold=True))

    # Name, value, where they stand, and the value's colour.
    numbers = [
        ("decision", f"{decision + 1} of {limit}", 0, 40, palette.INK),
        ("goals", f"{num_achieved} of {total}", 116, 40, goal_colour),
    ]
    if recording.direction is not None:
        direction = DIRECTION_NAMES[int(recording.direction[decision])]
        numbers.append(("subgoal", direction, 0, 96, palette.ARROW))

    for name, value, x, y, colour in numbers:
        pen.text((_LEFT + x, _TOP + y), name, palette.MUTED, _font(13))
        # The columns are 116 pixels apart: large numbers get small digits.
        size = 18 if len(value) <= 10 else 13 if len(value) <= 14 else 11
        pen.text((_LEFT + x, _TOP + y + 18), value, colour, _font(size, is_bold=True))
    if is_fallen:
        pen.text((_LEFT + 116, _TOP + 114), "fallen", palette.ROBOT, _font(18, is_bold=True))

    if recording.patch is not None:
        text = "what the high level sees"
        pen.text((_LEFT, _TOP + 152), text, palette.MUTED, _font(13))
        panel.paste(_patch_picture(recording.patch[decision]), (_LEFT, _TOP + 172))
    return panel


def add_plan(panel: Image.Image, maze: maze_lib.Maze, visited: Bool[np.ndarray, " G"]) -> None:
    """Adds a small plan of the whole maze to a panel, for a camera that sees a part of it."""
    wall, goal = np.asarray(maze.wall), np.asarray(maze.goal)
    image = np.where(wall[..., None], palette.rgb(palette.WALL), palette.rgb(palette.FLOOR))
    for number in np.unique(goal[goal > 0]):
        colour = palette.GOAL_ACHIEVED if visited[number - 1] else palette.GOAL
        image[goal == number] = palette.rgb(colour)

    small = Image.fromarray(np.round(255 * image).astype(np.uint8))
    # Cells that are smaller than a pixel are averaged, larger ones stay sharp.
    size = _plan_size(maze)
    is_larger = size[0] >= small.width
    kind = Image.Resampling.NEAREST if is_larger else Image.Resampling.BOX
    panel.paste(small.resize(size, kind), (_LEFT, _PLAN_TOP))


def mark_robot(
    page: Image.Image, left: int, maze: maze_lib.Maze, xy: Float[np.ndarray, "2"]
) -> None:
    """Shows on the plan of a panel where the robot is.

    Args:
      page: that the panel is part of.
      left: column at which the panel begins.
      maze: the maze.
      xy: where the torso is, units.
    """
    width, _ = _plan_size(maze)
    scale = width / (maze.wall.shape[1] * base.CELL)
    x, y = left + _LEFT + scale * xy[0], _PLAN_TOP - scale * xy[1]
    r = 3.5
    box = (x - r, y - r, x + r, y + r)
    ImageDraw.Draw(page).ellipse(box, palette.ROBOT, outline=palette.PAPER)


def _plan_size(maze: maze_lib.Maze) -> tuple[int, int]:
    """Returns width and height of the plan, pixels."""
    rows, columns = maze.wall.shape
    scale = min(_SIDE / columns, _PLAN_HEIGHT / rows)
    return max(1, round(scale * columns)), max(1, round(scale * rows))


def _patch_picture(patch: Bool[np.ndarray, "P P C"]) -> Image.Image:
    """Draws a patch: walls, goals and robot in the colours of the large picture."""
    small = Image.fromarray(np.round(255 * picture.colour_patch(patch)).astype(np.uint8))
    large = small.resize((_SIDE, _SIDE), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(large)
    # Between pixels that are larger than the lines.
    for i in range(1, len(patch)) if _SIDE >= 4 * len(patch) else ():
        at = round(i * _SIDE / len(patch))
        pen.line([(at, 0), (at, _SIDE)], palette.PAPER)
        pen.line([(0, at), (_SIDE, at)], palette.PAPER)
    return large
