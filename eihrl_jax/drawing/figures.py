"""Figures of matplotlib, without any display: how large, on what ground, and written as PNG."""

import pathlib
import sys
import warnings
from collections.abc import Callable

import matplotlib.axes
import matplotlib.figure
import matplotlib.text
from matplotlib.backends import backend_agg

from eihrl_jax import base
from eihrl_jax.drawing import palette
from eihrl_jax.storage import writing

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
    """Writes a figure as PNG, whole or not at all; all texts are shown as they are.

    Names of files and runs stand in many of them, which are no formulas, whatever dollars they
    hold, and may be of letters that the font lacks.
    """
    ticks = {
        label
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for label in axis.get_ticklabels(which="both")
    }
    # But powers of ten along an axis are formulas.
    for text in set(figure.findobj(matplotlib.text.Text)) - ticks:
        text.set_parse_math(False)
        text.set_text("\n".join(map(base.printable, text.get_text().split("\n"))))

    with writing.new_file(path) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        backend_agg.FigureCanvasAgg(figure).print_png(file)


def attempt(path: pathlib.Path, draw: Callable[[], object]) -> bool:
    """Draws a picture, or prints in one line why it can't: a failure must not lose numbers.

    Returns:
      Whether it has been drawn.
    """
    try:
        draw()
    except Exception as error:  # whatever it is: memory, a full disk, a font
        reason = base.printable(f"{error or type(error).__name__}".partition("\n")[0])
        print(f"warning: {path} couldn't be drawn: {reason}", file=sys.stderr)
        return False
    return True
