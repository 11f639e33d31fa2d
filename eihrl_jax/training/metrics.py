"""Metrics of many compiled steps as numbers for one row of a table."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def summarise(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Turns the metrics of some updates into means.

    Args:
      metrics: one number per update each; names that begin with `sum_` are sums over the episodes
        that ended during it, and `episodes` is their number.

    Returns:
      Means over the episodes that ended, NaN where none did, their names without `sum_`; and means
      over the updates that have a number.
    """
    # Sums over sums, so that every episode weighs the same, whichever update it ended in.
    episodes = float(np.sum(metrics["episodes"]))

    means = {}
    for name, values in sorted(metrics.items(), reverse=True):  # sums of episodes first
        if name.startswith("sum_"):
            total = float(np.sum(values))
            means[name.removeprefix("sum_")] = total / episodes if episodes else math.nan
        elif name != "episodes":
            # Rounds without an update report nan: nothing was learned there.
            known = np.asarray(values)[np.isfinite(values)]
            means[name] = float(known.mean()) if known.size else math.nan
    return means
