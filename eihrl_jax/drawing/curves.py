"""Learning curves from the `metrics.csv` of run folders, drawn with matplotlib."""

import csv
import dataclasses
import io
import itertools
import pathlib
from collections.abc import Mapping, Sequence

import matplotlib.axes
import matplotlib.figure
import matplotlib.ticker
import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.drawing import figures, palette
from eihrl_jax.evaluation import statistics
from eihrl_jax.storage import reading

_LINES = tuple(itertools.product(("-", "--", ":"), palette.CURVE))
_MARKERS = "os^DvPX"
_NUM_MARKERS = 3  # per curve: enough to tell it where it runs alone
_FEW_POINTS = 30

Curve = Float[np.ndarray, "_ 2"]
"""Points (x, y), x growing."""


def columns(path: pathlib.Path) -> tuple[str, ...]:
    """Returns the names of a `metrics.csv`'s columns; none if the file is empty.

    Raises:
      base.UserError: the file can't be read.
    """
    try:
        return tuple(rows(path).fieldnames or ())
    except (OSError, csv.Error) as error:
        raise base.UserError(f"{path} can't be read: {error}") from None


def read(path: pathlib.Path, x: str, y: str, *, may_be_empty: bool = False) -> Curve:
    """Reads two columns of a `metrics.csv`, leaving out rows in which either is empty or nan.

    Args:
      path: the file.
      x: name of the first column.
      y: name of the second column.
      may_be_empty: whether a run that has no number there yet is no error.

    Raises:
      base.UserError: the file can't be read, lacks a column, or holds no number in them.
    """
    try:
        pairs = [(row[x], row[y]) for row in rows(path)]
        points = np.array([pair for pair in pairs if all(pair)], float).reshape(-1, 2)
        points = points[np.isfinite(points).all(1)]
    except KeyError as error:
        raise base.UserError(f"{path} has no column {error}") from None
    except (OSError, ValueError) as error:
        raise base.UserError(f"{path} can't be read: {error}") from None

    if not len(points) and not may_be_empty:
        raise base.UserError(f"{path} holds no values of {x!r} and {y!r}")
    return points


def rows(path: pathlib.Path) -> "csv.DictReader[str]":
    """Reads the rows of a `metrics.csv` by column."""
    return csv.DictReader(io.StringIO(reading.read_text(path), newline=""))


def smooth(values: Float[np.ndarray, " N"], window: int) -> Float[np.ndarray, " N"]:
    """Averages each value with those around it, `window` in all, fewer at the ends."""
    half = min(window, len(values)) // 2
    # Differences of running sums, so that the window's size costs nothing.
    padded = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    return (padded[last] - padded[first]) / (last - first)


def save_spread(
    path: pathlib.Path,
    groups: Mapping[str, Sequence[Curve]],
    *,
    x_label: str,
    y_label: str,
    y_scale: float = 1.0,
    has_log_x: bool = False,
    labels: Sequence[str] = (),
) -> None:
    """Draws the mean of each group of curves and its range over the group, as PNG.

    Each has markers of its own, at places of their own, so that curves upon each other all show.

    Args:
      path: where the picture goes.
      groups: curves by label; those of a group are compared where all of them are, see `aligned`.
      x_label: what the horizontal axis is.
      y_label: what the vertical axis is, with its unit.
      y_scale: factor on the values, e.g. 100 for per cent.
      has_log_x: whether the horizontal axis is logarithmic.
      labels: of all pictures that are seen together, so that each keeps its line in all of them.
    """
    axes = new_axes(x_label, y_label)
    if has_log_x:
        axes.set_xscale("log")
        # Another scale brings its own labels with it.
        axes.xaxis.set_major_formatter(matplotlib.ticker.EngFormatter(sep=" "))

    all_labels = list(dict.fromkeys([*labels, *groups]))
    for label, curves in groups.items():
        i = all_labels.index(label)
        style, colour = _LINES[i % len(_LINES)]
        x, y = aligned(curves)
        y *= y_scale  # a fresh array of `aligned`, not the caller's
        axes.fill_between(x, y.min(0), y.max(0), color=colour, alpha=0.12, linewidth=0.0)

        # Markers of each curve begin elsewhere, so that none hides another's.
        step = -(-len(x) // _NUM_MARKERS)
        axes.plot(
            x,
            y.mean(0),
            style,
            color=colour,
            linewidth=2.0,
            marker=_MARKERS[i % len(_MARKERS)],
            markevery=(i * step // len(all_labels), step),
            label=label,
        )
    axes.set_ylim(bottom=-0.02 * axes.get_ylim()[1])  # where zero is seen as well
    axes.legend(  # above the axes, where no curve goes
        frameon=False,
        labelcolor=palette.INK,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        fontsize=8,
        ncols=4,
        handlelength=3.0,  # so that a broken line shows as one
    )
    write(axes, path)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves that share a vertical axis.

    Attributes:
      y_label: what the axis is, with its unit.
      groups: curves by label; those of a group are compared where all of them are, see `aligned`.
      y_range: limits of the axis; None: as the values need.
    """

    y_label: str
    groups: Mapping[str, Sequence[Curve]]
    y_range: tuple[float, float] | None = None


def save_panels(path: pathlib.Path, panels: Sequence[Panel], *, x_label: str) -> None:
    """Draws panels of curves, one below the other, as PNG.

    A curve alone is smoothed, with its raw values behind it. Several curves of a group are drawn as
    their mean, with Student's 95 % interval of it as a band.

    Args:
      path: where the picture goes.
      panels: one or more; a label has the same line in all of them.
      x_label: what the horizontal axis is.
    """
    figure = figures.new(7.0, 0.8 + 3.2 * len(panels))
    all_axes = figure.subplots(len(panels), squeeze=False)[:, 0].tolist()
    labels = list(dict.fromkeys(label for panel in panels for label in panel.groups))

    for axes, panel in zip(all_axes, panels, strict=True):
        _style(axes, x_label, panel.y_label)
        for label, curves in panel.groups.items():
            _draw_mean(axes, curves, label, labels)
        axes.set_xlim(left=0.0)
        if panel.y_range is not None:
            axes.set_ylim(*panel.y_range)

    # Once is enough, and a line that is alone needs no name.
    if len(labels) > 1:
        _add_legend(figure, all_axes)
    figures.save(figure, path)


def _draw_mean(
    axes: matplotlib.axes.Axes, curves: Sequence[Curve], label: str, all_labels: Sequence[str]
) -> None:
    """Draws one curve and what it was smoothed from, or the mean of several and its interval."""
    style, colour = _LINES[all_labels.index(label) % len(_LINES)]
    x, y = aligned(curves)
    # Few points are marked, or a single one wouldn't show.
    marker = "." if len(x) < _FEW_POINTS else None
    if len(curves) > 1:
        low, high = np.array([statistics.student(values) for values in y.T]).reshape(-1, 2).T
        axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0.0)
        line = y.mean(0)
    else:
        axes.plot(x, y[0], color=colour, alpha=0.25, linewidth=1.0)
        line = smooth(y[0], max(1, len(x) // 50))  # rows: a fiftieth of the curve
    axes.plot(x, line, style, color=colour, linewidth=2.0, marker=marker, label=label)


def _add_legend(figure: matplotlib.figure.Figure, all_axes: Sequence[matplotlib.axes.Axes]) -> None:
    """Names the lines of all axes above them."""
    handles = {
        label: handle
        for axes in all_axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles=list(handles.values()),
        labels=list(handles),
        loc="outside upper left",
        frameon=False,
        labelcolor=palette.INK,
        fontsize=8,
        handlelength=3.0,
    )


def aligned(
    curves: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[Float[np.ndarray, " X"], Float[np.ndarray, "C X"]]:
    """Reads curves at the same places: those of the one that ends first, within all of them.

    Args:
      curves: points (x, y), x growing.

    Returns:
      The places, and each curve's values there, straight between its points.
    """
    first = min(curves, key=lambda curve: curve[-1, 0])
    begin = max(curve[0, 0] for curve in curves)
    x = first[first[:, 0] >= begin, 0]
    return x, np.stack([np.interp(x, curve[:, 0], curve[:, 1]) for curve in curves])


def new_axes(x_label: str, y_label: str) -> matplotlib.axes.Axes:
    """Returns empty axes in the style of all pictures."""
    axes = figures.new(7.0, 4.2).add_subplot()
    _style(axes, x_label, y_label)
    return axes


def _style(axes: matplotlib.axes.Axes, x_label: str, y_label: str) -> None:
    """Gives axes the style of all pictures."""
    axes.set_facecolor(palette.PAPER)
    figures.label(axes, x_label, y_label)
    axes.xaxis.set_major_formatter(matplotlib.ticker.EngFormatter(sep=" "))
    axes.grid(color=palette.MUTED, alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(palette.MUTED)


def write(axes: matplotlib.axes.Axes, path: pathlib.Path) -> None:
    """Writes the picture of some axes, which begin at zero unless they are logarithmic."""
    if axes.get_xscale() == "linear":
        axes.set_xlim(left=0.0)
    figure = axes.figure
    assert isinstance(figure, matplotlib.figure.Figure)
    figures.save(figure, path)
