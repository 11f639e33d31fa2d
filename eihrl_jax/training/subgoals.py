"""Subgoal statistics: how evenly a low level carries out its subgoals (paper, Definition 3.1)."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def summarise(walked: dict[str, Float[Array, "T N"]]) -> dict[str, Float[Array, ""]]:
    """Summarises the metrics that `envs.locomotion.Locomotion` gave over T steps of N robots.

    Args:
      walked: `switched`, `along`, `lateral`, `fell`, `broke_down`, each [T, N].

    Returns:
      `along_mean`, `along_std`, `lateral_mean` (bias), `lateral_std` of the displacement per
      completed subgoal, in units, in the frame of its direction; `falls` and `breakdowns` per 1,000
      subgoals, where one that ended in a fall counts as begun; `num_subgoals`. NaN where no subgoal
      was completed.
    """
    switched = walked["switched"]
    completed = switched.sum()
    along_mean, along_std = _moments(walked["along"], switched)
    lateral_mean, lateral_std = _moments(walked["lateral"], switched)
    falls, breakdowns = walked["fell"].sum(), walked["broke_down"].sum()
    begun = jnp.maximum(completed + falls + breakdowns, 1.0)
    return {
        "along_mean": along_mean,
        "along_std": along_std,
        "lateral_mean": lateral_mean,
        "lateral_std": lateral_std,
        "falls": 1000.0 * falls / begun,
        "breakdowns": 1000.0 * breakdowns / begun,
        "num_subgoals": begun,
    }


def _moments(
    values: Float[Array, "T N"], weights: Float[Array, "T N"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns mean and standard deviation of the values whose weight is 1."""
    mean = jnp.sum(weights * values) / weights.sum()
    return mean, jnp.sqrt(jnp.sum(weights * jnp.square(values - mean)) / weights.sum())
