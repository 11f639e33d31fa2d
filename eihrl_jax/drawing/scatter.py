"""Where subgoals ended: a scatter of end points per direction, drawn with matplotlib."""

import pathlib
from collections.abc import Mapping

import matplotlib.patches
import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.drawing import figures, palette

_NAMES = ("x+", "x-", "y+", "y-")
_EXTENT = 5.0  # units to each side: a cell of 3, and what goes beyond it


def save(
    path: pathlib.Path,
    ends: Mapping[int, Float[np.ndarray, "S 2"]],
    title: str,
    sigma: float,
) -> None:
    """Draws the displacements of all subgoals around where they began, as PNG.

    A cross marks one cell in each direction; the circle around it, of radius 3 sigma, holds 99 % of
    what the high level trains with.

    Args:
      path: where the picture goes.
      ends: displacements in units, world frame, by direction.
      title: what is shown.
      sigma: standard deviation per axis of the normal law to compare with, units.
    """
    figure = figures.new(6.0, 6.2)
    axes = figure.add_subplot()
    axes.set_facecolor(palette.PAPER)
    for index, points in ends.items():
        if not len(points):
            continue
        colour = palette.CURVE[index]
        axes.scatter(*points.T, s=3.0, alpha=0.35, color=colour, linewidths=0.0)

        # Where the subgoal points, and within what of it the high level has learned to expect.
        target = np.multiply(base.CELL, base.DIRECTIONS_XY[index])
        axes.plot(*target, marker="+", markersize=11, color=palette.INK)
        axes.add_patch(
            matplotlib.patches.Circle(tuple(target), 3.0 * sigma, fill=False, color=palette.MUTED)
        )

        # The legend has the numbers that the cloud shows; an empty line stands for it there.
        moments = points.mean(0), points.std(0)
        mean, std = ("({:.2f}, {:.2f})".format(*pair) for pair in moments)
        text = f"{_NAMES[index]}: {mean} ± {std}"
        axes.plot([], [], "o", color=colour, markersize=5, label=text)

    axes.plot(0.0, 0.0, marker="o", color=palette.INK, markersize=5)
    axes.set(xlim=(-_EXTENT, _EXTENT), ylim=(-_EXTENT, _EXTENT), aspect="equal")
    since = "since the subgoal was given, units"
    figures.label(axes, f"x {since}", f"y {since}")
    axes.set_title(title, loc="left", color=palette.INK, weight="bold")
    axes.grid(color=palette.MUTED, alpha=0.25, linewidth=0.6)
    axes.spines[:].set_visible(False)
    axes.legend(frameon=False, labelcolor=palette.INK, loc="upper left", fontsize=7)
    figures.save(figure, path)
