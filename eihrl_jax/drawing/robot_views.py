"""A robot in its cell, from above and from the side, drawn with matplotlib."""

import pathlib

import matplotlib.axes
import matplotlib.patches
import numpy as np
from jaxtyping import Float

from eihrl_jax.drawing import figures, palette

Capsules = tuple[
    Float[np.ndarray, "G 3"],
    Float[np.ndarray, "G 3"],
    Float[np.ndarray, " G"],
]
"""Start points, end points and radii, in metres."""


def save(path: pathlib.Path, capsules: Capsules, cell: float, title: str) -> None:
    """Draws a robot's parts in a cell whose middle is the origin, as PNG.

    Args:
      path: where the picture goes.
      capsules: its parts.
      cell: side of the cell, metres; walls are as high.
      title: what is shown.
    """
    figure = figures.new(9.0, 4.6)
    for index, (name, height) in enumerate((("y", 1), ("z", 2))):
        axes = figure.add_subplot(1, 2, index + 1)
        low = -cell / 2 if name == "y" else 0.0
        axes.set_facecolor(palette.PAPER)
        frame = matplotlib.patches.Rectangle((-cell / 2, low), cell, cell, color=palette.FLOOR)
        axes.add_patch(frame)

        start, end, radius = capsules
        for one, other, width in zip(start, end, radius.tolist(), strict=True):
            _add(axes, one[[0, height]], other[[0, height]], width)
        margin = 0.1 * cell
        axes.set(xlim=(-cell / 2 - margin, cell / 2 + margin), aspect="equal")
        axes.set_ylim(low - margin, low + cell + margin)
        figures.label(axes, "x, m", f"{name}, m")
        axes.spines[:].set_visible(False)

    figure.suptitle(title, color=palette.INK, weight="bold")
    figures.save(figure, path)


def _add(
    axes: matplotlib.axes.Axes,
    one: Float[np.ndarray, "2"],
    other: Float[np.ndarray, "2"],
    radius: float,
) -> None:
    """Adds a capsule's outline in the plane: two circles and what lies between them."""
    along = other - one
    length = float(np.hypot(*along))
    aside = radius * np.array([-along[1], along[0]]) / max(length, 1e-9)
    colour = {"facecolor": palette.ROBOT, "edgecolor": "none", "alpha": 0.8}
    corners = np.stack([one + aside, other + aside, other - aside, one - aside])
    axes.add_patch(matplotlib.patches.Polygon(corners, **colour))
    for point in (one, other):
        axes.add_patch(matplotlib.patches.Circle(tuple(point), radius, **colour))
