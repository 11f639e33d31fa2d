"""Where episodes ended that failed, and of what: plans of mazes, drawn with matplotlib."""

import collections
import dataclasses
import pathlib
from collections.abc import Sequence

import matplotlib.lines
import numpy as np
from jaxtyping import Float

from eihrl_jax.drawing import figures, layout, palette
from eihrl_jax.evaluation import results
from eihrl_jax.mazes import maze as maze_lib

_NUM_COLUMNS = 4
_MARKS = {
    "late": ("o", palette.TRAIL),
    "fallen": ("X", palette.ROBOT),
    "unstable": ("^", palette.CURVE[3]),
}
"""Marker and colour of each way to fail."""


@dataclasses.dataclass(frozen=True)
class Endings:
    """How the episodes of one agent in one maze ended.

    Attributes:
      title: what the picture is called.
      maze: the maze as it was loaded.
      outcomes: one of `results.OUTCOMES` for each of E episodes.
      end_xy: float [E, 2], where the torso was then, units.
    """

    title: str
    maze: maze_lib.Maze
    outcomes: Sequence[str]
    end_xy: Float[np.ndarray, "E 2"]


def save(path: pathlib.Path, endings: Sequence[Endings]) -> None:
    """Draws the plans of some mazes with a mark where each episode ended that failed, as PNG."""
    num_columns = min(_NUM_COLUMNS, len(endings))
    num_rows = -(-len(endings) // num_columns)
    # As high as the mazes are, so that a long one has no empty paper around it.
    shapes = [item.maze.wall.shape for item in endings]
    ratio = np.clip(max(rows / columns for rows, columns in shapes), 0.4, 1.5)
    width = 5.4 if num_columns == 1 else 3.6
    figure = figures.new(width * num_columns, (width * ratio + 0.7) * num_rows + 0.3)

    for i, item in enumerate(endings):
        axes = figure.add_subplot(num_rows, num_columns, i + 1)
        counts = collections.Counter(item.outcomes)
        told = ", ".join(f"{counts[name]} {name}" for name in results.OUTCOMES if counts[name])
        layout.draw(axes, item.maze, title=f"{item.title}\n{told}")
        axes.set(xlabel="", ylabel="")
        axes.tick_params(labelbottom=False, labelleft=False, length=0)

        # Above the plan: who falls may come to lie on the edge of a wall.
        for name, (marker, colour) in _MARKS.items():
            is_this = np.array(item.outcomes) == name
            x, y = item.end_xy[is_this].T
            axes.scatter(x, y, 26.0, colour, marker=marker, alpha=0.6, linewidths=0.0, zorder=5)

    # What failed nowhere needs no explanation.
    failed = {name for item in endings for name in item.outcomes} & _MARKS.keys()
    handles = [
        matplotlib.lines.Line2D([], [], ls="", marker=marker, color=colour, label=f"ended {name}")
        for name, (marker, colour) in _MARKS.items()
        if name in failed
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), frameon=False)
    figures.save(figure, path)
