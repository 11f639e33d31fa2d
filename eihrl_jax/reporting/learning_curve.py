"""A run's learning curve, drawn into its folder."""

import pathlib
from collections.abc import Mapping

from eihrl_jax.drawing import curves

_HIGH_CURVES = {"workers in training": "success", "evaluation": "eval/success"}


def draw(
    run: pathlib.Path,
    columns: Mapping[str, str] = _HIGH_CURVES,
    *,
    x: str = "num_decisions",
    x_label: str = "decisions",
    y_label: str = "success, %",
) -> pathlib.Path:
    """Draws success while a run learned into its folder, of `train_high` unless told otherwise.

    Args:
      run: its folder.
      columns: columns of its metrics, by label.
      x: the column against which they are drawn.
      x_label: what that is.
      y_label: what they are.

    Returns:
      The picture's path.

    Raises:
      base.UserError: the folder has no such metrics.
    """
    metrics = run / "metrics.csv"
    path = run / "learning_curve.png"
    curves.save(
        path,
        {label: curves.read(metrics, x, column) for label, column in columns.items()},
        x_label=x_label,
        y_label=y_label,
        y_scale=100.0,  # metrics hold shares
        y_range=(0.0, 100.0),  # all of it, so that curves of different runs can be compared
    )
    return path
