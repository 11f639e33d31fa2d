"""Heatmaps of visited positions (paper, Figure 7), drawn with matplotlib's object interface."""

import dataclasses
import pathlib
from collections.abc import Sequence

import matplotlib.axes
import matplotlib.cm
import matplotlib.colors
import matplotlib.figure
import matplotlib.lines
import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.drawing import figures, layout, palette
from eihrl_jax.evaluation import whereabouts
from eihrl_jax.mazes import maze as maze_lib


@dataclasses.dataclass(frozen=True)
class Visits:
    """Where the torso was in one maze.

    Attributes:
      title: what the picture is called.
      maze: the maze as it was loaded, its door candidates not yet drawn.
      share: float [R * b, C * b], b = `whereabouts.BINS_PER_CELL`, share of the episodes in which
        the torso was in a bin at least once, in [0, 1]; row 0 is the north.
    """

    title: str
    maze: maze_lib.Maze
    share: Float[np.ndarray, "rows columns"]


def save(path: pathlib.Path, visits: Visits) -> None:
    """Draws the heatmap of one maze with the marginal frequencies beside it, as PNG."""
    rows, columns = visits.maze.wall.shape
    figure = figures.new(7.2, 5.3 * min(rows / columns, 1.3) + 1.4)
    axes = figure.add_subplot()
    norm = _norm([visits])
    _draw(axes, visits, norm)
    figures.label(axes, "x, units", "y, units")

    # Insets stay beside the maze whatever size its aspect leaves it.
    top = axes.inset_axes((0.0, 1.02, 1.0, 0.14), sharex=axes)
    right = axes.inset_axes((1.02, 0.0, 0.14, 1.0), sharey=axes)
    scale = axes.inset_axes((1.20, 0.0, 0.035, 1.0))

    side = base.CELL / whereabouts.BINS_PER_CELL
    x = (np.arange(visits.share.shape[1]) + 0.5) * side
    top.bar(x, visits.share.sum(0), width=side, color=palette.GOAL)
    top.set_title(visits.title, loc="left", color=palette.INK, weight="bold")
    y = -(np.arange(visits.share.shape[0]) + 0.5) * side
    right.barh(y, visits.share.sum(1), height=side, color=palette.GOAL)
    for marginal in (top, right):
        marginal.spines[:].set_visible(False)
        marginal.tick_params(length=0, labelbottom=False, labelleft=False)
        marginal.set_facecolor("none")
    _add_bar(figure, scale, norm)
    _add_legend(figure)
    figures.save(figure, path)


def save_together(path: pathlib.Path, visits: Sequence[Visits], *, num_columns: int = 4) -> None:
    """Draws several mazes on one colour scale, as PNG."""
    num_columns = min(num_columns, len(visits))
    num_rows = -(-len(visits) // num_columns)
    figure = figures.new(3.3 * num_columns + 1.0, 3.5 * num_rows + 0.7)
    grid = figure.add_gridspec(num_rows, num_columns + 1, width_ratios=[20] * num_columns + [1])

    # One scale for all, so that equal colours are equal shares.
    norm = _norm(visits)
    for i, item in enumerate(visits):
        axes = figure.add_subplot(grid[i // num_columns, i % num_columns])
        _draw(axes, item, norm)
        axes.set_title(item.title, loc="left", color=palette.INK, fontsize=10)
        axes.tick_params(labelbottom=False, labelleft=False, length=0)

    _add_bar(figure, figure.add_subplot(grid[:, -1]), norm)
    _add_legend(figure)
    figures.save(figure, path)


def _add_legend(figure: matplotlib.figure.Figure) -> None:
    """Explains the marks of goals and starts below a figure."""
    line = matplotlib.lines.Line2D
    marks = [
        line([], [], ls="", marker="s", markersize=9, mfc="none", mec=palette.GOAL, label="goal"),
        line([], [], ls="", marker="o", markersize=8, mfc="none", mec=palette.INK, label="start"),
    ]
    figure.legend(handles=marks, loc="outside lower left", ncols=2, frameon=False)


def _norm(visits: Sequence[Visits]) -> matplotlib.colors.Normalize:
    """Returns a scale in per cent up to the most visited place, bright where few came by, too."""
    # The square root of the share is what is coloured; a maze nobody entered has a scale too.
    highest = max(float(item.share.max()) for item in visits)
    return matplotlib.colors.PowerNorm(0.5, 0.0, 100.0 * highest or 1.0)


def _add_bar(
    figure: matplotlib.figure.Figure, axes: matplotlib.axes.Axes, norm: matplotlib.colors.Normalize
) -> None:
    """Draws the colour bar into axes of its own."""
    bar = figure.colorbar(matplotlib.cm.ScalarMappable(norm, palette.HEAT), cax=axes)
    bar.set_label("episodes that came by, %", color=palette.INK)
    bar.outline.set_visible(False)


def _draw(axes: matplotlib.axes.Axes, visits: Visits, norm: matplotlib.colors.Normalize) -> None:
    """Draws heat, walls, goals and starts of one maze."""
    axes.imshow(
        100.0 * visits.share,
        norm=norm,
        cmap=palette.HEAT,
        extent=layout.extent(visits.maze),
        interpolation="nearest",
    )
    layout.add_marks(axes, visits.maze, start_colour="white")
