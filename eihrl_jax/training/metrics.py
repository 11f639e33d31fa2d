"""Metrics of many compiled steps as numbers for one row of a table."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

_MANY_EPISODES = 5  # of the longest kind: so many dilute what the first ones distort


def is_fair(begin: float, end: float, limit: float) -> bool:
    """Returns whether the episodes that ended in a stretch of steps stand for all that began.

    Environments begin together. Until the time limit has passed once, what has ended is short: in
    a maze those episodes that reached the goal, 100 % of them. Around the limit all long ones end
    at the same time.

    Args:
      begin: steps that an environment had made before the stretch.
      end: steps that it had made by its end.
      limit: most steps of an episode.
    """
    return begin >= limit or end - begin >= _MANY_EPISODES * limit


def summarise(metrics: Mapping[str, Any], *, is_fair: bool = True) -> dict[str, float]:
    """Turns the metrics of some updates into means.

    Args:
      metrics: one number per update each; names that begin with `sum_` are sums over the episodes
        that ended during it, and `episodes` is their number.
      is_fair: whether these episodes stand for all, see the function of that name.

    Returns:
      Means over the episodes that ended, NaN where none did or they don't stand for all, their
      names without `sum_`; and means over the updates that have a number.
    """
    # Sums over sums, so that every episode weighs the same, whichever update it ended in.
    episodes = float(np.sum(metrics["episodes"])) if is_fair else 0.0

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
