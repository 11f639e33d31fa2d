"""A run's learning curve, drawn into its folder while it trains and at the end."""

import contextlib
import dataclasses
import pathlib

from eihrl_jax import base
from eihrl_jax.drawing import curves, figures
from eihrl_jax.runs import metrics_log, run_folder

FILE = "learning_curve.png"
"""Name of the picture in a run's folder."""


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What a metric measures.

    Attributes:
      label: of the axis, with the unit.
      scale: factor on the values, e.g. 100 for per cent.
      y_range: all that it can be, after scaling, so that pictures of several runs can be compared.
      digits: decimals that are worth telling.
    """

    label: str
    scale: float = 1.0
    y_range: tuple[float, float] | None = None
    digits: int = 3


QUANTITIES = {
    "success": Quantity("success, %", 100.0, (-2.0, 102.0), 1),
    "reward": Quantity("reward per step"),
    "along_mean": Quantity("displacement along, units", digits=2),
    "lateral_std": Quantity("displacement sideways, std, units", digits=2),
    "falls": Quantity("falls per 1,000 subgoals", digits=1),
}
"""Quantities by the last part of a metric's name: those that measure performance."""

_WHEN = {"while training": "", "evaluation": "eval/", "evaluation, walking": "walking/"}


def draw(run: pathlib.Path) -> pathlib.Path:
    """Draws how well a run did while it learned into its folder: a panel for each quantity.

    Args:
      run: its folder.

    Returns:
      The picture's path.

    Raises:
      base.UserError: nothing has been measured yet, or the metrics can't be read.
    """
    metrics = run / metrics_log.FILE
    there = curves.columns(metrics)
    x, is_dense = x_of(there), _is_dense(run)

    panels = []
    for name, quantity in QUANTITIES.items():
        lines = {
            label: points(metrics, x, prefix + name)
            for label, prefix in _WHEN.items()
            if prefix + name in there
        }
        groups = {label: [line] for label, line in lines.items() if len(line)}
        # Sparse rewards are success in another unit.
        if groups and (name != "reward" or is_dense):
            panels.append(
                curves.Panel(y_label=quantity.label, groups=groups, y_range=quantity.y_range)
            )
    if not panels:
        raise base.UserError(f"{metrics} holds no numbers yet")

    path = run / FILE
    curves.save_panels(path, panels, x_label=X_LABELS.get(x, x))
    return path


def renew(run: pathlib.Path) -> None:
    """Draws the curve of a run that goes on, if there is something to draw and it can be drawn."""

    def draw_if_any() -> None:
        # The first rows may have no number.
        with contextlib.suppress(base.UserError):
            draw(run)

    figures.attempt(run / FILE, draw_if_any)


def _is_dense(run: pathlib.Path) -> bool:
    """Returns whether a run's reward differs from its success."""
    options = run_folder.read_options(run)
    return "dense" in (options.get("reward"), options.get("task.reward"))


X_LABELS = {"num_decisions": "decisions", "step": "steps"}
"""What the columns that runs count in are called in pictures."""


def x_of(columns: tuple[str, ...]) -> str:
    """Returns the best column for the horizontal axis, such as steps."""
    return "num_decisions" if "num_decisions" in columns else "step"


def quantity_of(metric: str) -> Quantity:
    """Returns what a metric measures; the name itself stands for what isn't in the table."""
    known = QUANTITIES.get(metric.rpartition("/")[2])
    return Quantity(metric) if known is None else known


def points(metrics: pathlib.Path, x: str, y: str) -> curves.Curve:
    """Reads two columns, see `curves.read`, in the units of `QUANTITIES`; there may be no rows.

    Raises:
      base.UserError: the file can't be read or lacks a column.
    """
    return curves.read(metrics, x, y, may_be_empty=True) * [1.0, quantity_of(y).scale]
