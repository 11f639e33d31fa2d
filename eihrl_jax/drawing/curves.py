"""Learning curves from the `metrics.csv` of run folders, drawn with matplotlib."""

import csv
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

_LINES = tuple(itertools.product(("-", "--", ":"), palette.CURVE))
_MARKERS = "os^DvPX"
_NUM_MARKERS = 3  # per curve: enough to tell it where it runs alone


def columns(path: pathlib.Path) -> tuple[str, ...]:
    """Returns the names of a `metrics.csv`'s columns; none if the file is empty.

    Raises:
      base.UserError: the file can't be read.
    """
    try:
        with path.open(newline="") as file:
            return tuple(csv.DictReader(file).fieldnames or ())
    except (OSError, ValueError) as error:
        raise base.UserError(f"{path} can't be read: {error}") from None


def read(path: pathlib.Path, x: str, y: str) -> Float[np.ndarray, "N 2"]:
    """Reads two columns of a `metrics.csv`, leaving out rows in which either is empty or nan.

    Args:
      path: the file.
      x: name of the first column.
      y: name of the second column.

    Raises:
      base.UserError: the file can't be read, lacks a column, or holds no number in them.
    """
    try:
        with path.open(newline="") as file:
            rows = [(row[x], row[y]) for row in csv.DictReader(file)]
        points = np.array([pair for pair in rows if all(pair)], float).reshape(-1, 2)
        points = points[np.isfinite(points).all(1)]
    except KeyError as error:
        raise base.UserError(f"{path} has no column {error}") from None
    except (OSError, ValueError) as error:
        raise base.UserError(f"{path} can't be read: {error}") from None

    if not len(points):
        raise base.UserError(f"{path} holds no values of {x!r} and {y!r}")
    return points


def smooth(values: Float[np.ndarray, " N"], window: int) -> Float[np.ndarray, " N"]:
    """Averages each value with those around it, `window` in all, fewer at the ends."""
    half = min(window, len(values)) // 2
    # Differences of running sums, so that the window's size costs nothing.
    padded = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    return (padded[last] - padded[first]) / (last - first)


def save(
    path: pathlib.Path,
    curves: Mapping[str, Float[np.ndarray, "_ 2"]],
    *,
    x_label: str,
    y_label: str,
    y_scale: float = 1.0,
    y_range: tuple[float, float] | None = None,
) -> None:
    """Draws curves, each smoothed, with its raw values behind it, as PNG.

    Args:
      path: where the picture goes.
      curves: points by label; one curve gets no legend.
      x_label: what the horizontal axis is.
      y_label: what the vertical axis is, with its unit.
      y_scale: factor on the values, e.g. 100 for per cent.
      y_range: limits of the vertical axis after scaling; None: as the values need.
    """
    axes = new_axes(x_label, y_label)
    for i, (label, points) in enumerate(curves.items()):
        colour = palette.CURVE[i % len(palette.CURVE)]
        x, y = points[:, 0], y_scale * points[:, 1]
        axes.plot(x, y, color=colour, alpha=0.25, linewidth=1.0)
        window = max(1, len(y) // 50)  # rows: a fiftieth of the curve
        axes.plot(x, smooth(y, window), color=colour, linewidth=2.0, label=label)

    if y_range is not None:
        axes.set_ylim(*y_range)
    if len(curves) > 1:
        axes.legend(frameon=False, labelcolor=palette.INK, loc="lower right")
    write(axes, path)


def save_spread(
    path: pathlib.Path,
    groups: Mapping[str, Sequence[Float[np.ndarray, "_ 2"]]],
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
    axes.set_facecolor(palette.PAPER)
    figures.label(axes, x_label, y_label)
    axes.xaxis.set_major_formatter(matplotlib.ticker.EngFormatter(sep=" "))
    axes.grid(color=palette.MUTED, alpha=0.25, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(palette.MUTED)
    return axes


def write(axes: matplotlib.axes.Axes, path: pathlib.Path) -> None:
    """Writes the picture of some axes, which begin at zero unless they are logarithmic."""
    if axes.get_xscale() == "linear":
        axes.set_xlim(left=0.0)
    figure = axes.figure
    assert isinstance(figure, matplotlib.figure.Figure)
    figures.save(figure, path)
