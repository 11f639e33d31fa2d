"""Folder of a comparison of movements: the gaps, their table, and a picture beside the bounds."""

import json

import matplotlib.ticker
import numpy as np

from eihrl_jax import mazes
from eihrl_jax.config import value_gap as gap_config
from eihrl_jax.drawing import curves, figures, palette
from eihrl_jax.evaluation import tables
from eihrl_jax.evaluation import value_gap as gap_lib
from eihrl_jax.runs import folders, versions
from eihrl_jax.storage import writing
from eihrl_jax.theory import displacement, gaussians


def compare(options: gap_config.ValueGapConfig) -> list[gap_lib.Gap]:
    """Measures all gaps, and fills the folder.

    Args:
      options: what is compared.

    Returns:
      The gaps, oracle movement first.

    Raises:
      base.UserError: the folder isn't free; a maze has several goals; a policy or maze is unknown.
    """
    with folders.reserved(options.out):
        gaps = gap_lib.compare(options)
        _write(options, gaps)
        figures.attempt(options.out / "gap.png", lambda: _draw(options, gaps))
    return gaps


def _write(options: gap_config.ValueGapConfig, gaps: list[gap_lib.Gap]) -> None:
    """Writes numbers and table."""
    about = {"reference": options.reference, "gamma": options.gamma}
    document = about | {"gaps": [vars(gap) for gap in gaps], "versions": versions.describe()}
    writing.write_text(options.out / "gap.json", json.dumps(document, indent=2) + "\n")
    writing.write_text(options.out / "gap.md", markdown(gaps))


def _draw(options: gap_config.ValueGapConfig, gaps: list[gap_lib.Gap]) -> None:
    """Draws the success that oracle movement loses, by noise level, beside its bound."""
    # With physics there is no noise level to draw it at.
    oracle = [gap for gap in gaps if gap.sigma is not None]
    axes = curves.new_axes("standard deviation per axis, units", "lost success, percentage points")
    axes.xaxis.set_major_formatter(matplotlib.ticker.ScalarFormatter())

    for i, maze in enumerate(options.mazes):
        here = sorted((g for g in oracle if g.maze == maze), key=lambda gap: gap.sigma or 0.0)
        axes.errorbar(
            [gap.sigma or 0.0 for gap in here],
            [100.0 * gap.success_gap for gap in here],
            yerr=[100.0 * gap.success_margin for gap in here],
            color=palette.CURVE[i % len(palette.CURVE)],
            marker="o",
            capsize=3.0,
            label=f"measured, {maze}",
        )

    # The loosest bound of the mazes: it grows with the time limit.
    limit = max(int(maze.num_decisions) for maze in mazes.load_all(options.mazes).values())
    sigmas = np.linspace(0.01, max(1.0, 2 * options.reference), 991)
    # Theory: the chance to part in one decision, then within the limit (docs/theory.md).
    rate = gaussians.scale_total_variation(sigmas, options.reference)
    bound = 100.0 * displacement.success_gap_bound(rate, limit)
    axes.plot(sigmas, bound, color=palette.INK, label=f"bound, {limit} decisions")

    axes.legend(frameon=False, labelcolor=palette.INK, loc="center right")
    curves.write(axes, options.out / "gap.png")


def markdown(gaps: list[gap_lib.Gap]) -> str:
    """Returns the gaps as a Markdown table, in percentage points, with 95 % intervals.

    A bound that allows everything is called vacuous.
    """
    # Two columns `bound`, each of the loss on its left.
    header = ["maze", "movement", "success %", "lost success", "bound", "lost value", "bound"]
    rows = [
        [
            gap.maze,
            # Physics has no noise level of its own.
            f"{gap.movement}, {'walking' if gap.sigma is None else f'sigma {gap.sigma:g}'}",
            f"{100.0 * gap.success:.1f}",
            f"{100.0 * gap.success_gap:.1f} ± {100.0 * gap.success_margin:.1f}",
            _percent(gap.success_bound),
            f"{100.0 * gap.value_gap:.1f} ± {100.0 * gap.value_margin:.1f}",
            _percent(gap.value_bound),
        ]
        for gap in gaps
    ]
    return tables.markdown_grid(header, rows) + "\n"


def _percent(bound: float) -> str:
    return "vacuous" if bound > 0.99 else f"{100.0 * bound:.1f}"
