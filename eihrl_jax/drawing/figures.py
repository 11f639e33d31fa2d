"""Figures of matplotlib, without any display: how large, on what ground, and written as PNG."""

import pathlib

import matplotlib.axes
import matplotlib.figure
from matplotlib.backends import backend_agg

from eihrl_jax.drawing import palette

_DPI = 160  # dots per inch: sharp on a page at half its size


def new(width: float, height: float) -> matplotlib.figure.Figure:
    """Returns an empty figure of `width` x `height` inches."""
    return matplotlib.figure.Figure(
        figsize=(width, height), dpi=_DPI, facecolor=palette.PAPER, layout="constrained"
    )


def label(axes: matplotlib.axes.Axes, x: str, y: str) -> None:
    """Names what axes show, with its unit, in the colour of all text; ticks get it too."""
    axes.set_xlabel(x, color=palette.INK)
    axes.set_ylabel(y, color=palette.INK)
    axes.tick_params(colors=palette.INK)


def save(figure: matplotlib.figure.Figure, path: pathlib.Path) -> None:
    """Writes a figure as PNG."""
    backend_agg.FigureCanvasAgg(figure).print_png(str(path))
