"""Figures of matplotlib, without any display: how large, on what ground, and written as PNG."""

import pathlib

import matplotlib.figure
from matplotlib.backends import backend_agg

from eihrl_jax.drawing import palette

_DPI = 160


def new(width: float, height: float) -> matplotlib.figure.Figure:
    """Returns an empty figure of `width` x `height` inches."""
    return matplotlib.figure.Figure(
        figsize=(width, height), dpi=_DPI, facecolor=palette.PAPER, layout="constrained"
    )


def save(figure: matplotlib.figure.Figure, path: pathlib.Path) -> None:
    """Writes a figure as PNG."""
    backend_agg.FigureCanvasAgg(figure).print_png(str(path))
