"""Options of plotting and comparing existing runs."""

import pathlib

from eihrl_jax import base
from eihrl_jax.config import limits


@limits.dataclass
class PlotConfig:
    """Draws metrics of runs, finished or not: one panel for each metric.

    Runs that differ in nothing but their seed are one line, their mean, with its 95 % interval. A
    line is named by the options in which it differs from the others.

    Attributes:
      runs: run folders.
      metrics: columns of their metrics.csv, e.g. eval/success; none: those that tell how well they
        do.
      x: column of the horizontal axis; none: what the runs count in.
      out: the picture, PNG; one that is there is drawn anew.
    """

    runs: limits.Several[pathlib.Path]
    metrics: tuple[str, ...] = ()
    x: str | None = None
    out: pathlib.Path = pathlib.Path("runs/plot.png")

    def __post_init__(self) -> None:
        """Checks the picture's name, as nothing but a picture may be overwritten."""
        if self.out.suffix != ".png":
            raise base.UserError(f"out = {self.out} must end in .png")


@limits.dataclass
class CompareRunsConfig:
    """Compares runs: the options in which they differ, their last metrics and durations.

    Attributes:
      runs: two run folders or more.
      metrics: further columns of their metrics.csv, whose last values are shown.
    """

    runs: limits.Several[pathlib.Path]
    metrics: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Checks that there is something to compare."""
        if len(self.runs) < 2:
            raise base.UserError(
                f"runs = {', '.join(map(str, self.runs))} is one; give at least two"
            )
