"""From how a robot carries out subgoals to what a hierarchy may lose by it.

A displacement law is a Gaussian in the plane, along and across the subgoal. Two robots that start a
subgoal in the same place end it in places that are the same function of their displacements (walls
included), so the laws of their ends are no farther apart in total variation than those of their
displacements. docs/theory.md says what that assumes of a walking robot.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from eihrl_jax.theory import arguments
from eihrl_jax.theory.arguments import Correlation, Counts, Floats, Positive, Real, Shares


@dataclasses.dataclass(frozen=True, kw_only=True)
class Displacement:
    """A Gaussian law of the displacement during one subgoal.

    Attributes:
      mean: along the subgoal and to its left, units.
      covariance: of the two, square units, positive definite.
    """

    mean: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]

    @classmethod
    @arguments.checked
    def of(
        cls,
        along_mean: Real,
        along_std: Positive,
        lateral_mean: Real = 0.0,
        lateral_std: Positive | None = None,
        correlation: Correlation = 0.0,
    ) -> "Displacement":
        """Makes the law from the statistics that `measure_low` writes, all in units.

        Args:
          along_mean: mean along the subgoal.
          along_std: its standard deviation, positive.
          lateral_mean: mean to the left.
          lateral_std: its standard deviation, positive; None: as along.
          correlation: between the two, in (-1, 1).

        Raises:
          ValueError: an argument is out of its range.
        """
        lateral_std = along_std if lateral_std is None else lateral_std
        both = correlation * along_std * lateral_std  # the covariance of the two axes
        return cls(
            mean=np.array([along_mean, lateral_mean]),
            covariance=np.array([[along_std**2, both], [both, lateral_std**2]]),
        )


def total_variation(first: Displacement, second: Displacement, *, num_points: int = 801) -> float:
    """Computes the total variation between two displacement laws.

    Args:
      first: one law.
      second: the other.
      num_points: per axis of the grid on which the difference of the densities is summed; the
        default is exact to about four digits unless one law is a hundred times as wide.

    Returns:
      Half the integral of the densities' difference, in [0, 1].
    """
    laws = (first, second)
    stds = np.array([np.sqrt(np.diag(law.covariance)) for law in laws])
    means = np.array([law.mean for law in laws])

    # A sum over a grid that reaches eight standard deviations beyond both means.
    low, high = (means - 8.0 * stds).min(0), (means + 8.0 * stds).max(0)
    axes = [np.linspace(low[i], high[i], num_points) for i in range(2)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    area = np.prod([axis[1] - axis[0] for axis in axes])

    # Total variation is half the L1 distance; a sum over a grid can exceed 1 by rounding.
    apart = np.abs(_density(points, first) - _density(points, second))
    return min(1.0, float(apart.sum() * area / 2.0))


def wasserstein_bound(first: Displacement, second: Displacement) -> float:
    """Bounds the Wasserstein-1 distance of two displacement laws by their Wasserstein-2 distance.

    Returns:
      sqrt(|m - n|^2 + tr(A + B - 2 (A^1/2 B A^1/2)^1/2)), units.

    Source: Gelbrich, On a formula for the L2 Wasserstein metric between measures on Euclidean and
      Hilbert spaces, Mathematische Nachrichten 147 (1990).
    """
    # Gelbrich's formula; exact for Gaussians, and W1 is at most W2.
    root = _square_root(first.covariance)
    cross = _square_root(root @ second.covariance @ root)
    spread = np.trace(first.covariance + second.covariance - 2.0 * cross)
    shift = float(np.sum((first.mean - second.mean) ** 2))
    return math.sqrt(max(shift + float(spread), 0.0))


@arguments.checked
def success_gap_bound(total_variation: Shares, num_decisions: Counts) -> Floats:
    """Bounds how much the chance of success within a time limit changes.

    Args:
      total_variation: in [0, 1], between the displacement laws of one subgoal.
      num_decisions: integers, at least 1, time limit in subgoals.

    Returns:
      1 - (1 - delta)^T: the chance that two robots, coupled as well as can be, ever part.

    Raises:
      ValueError, TypeError: an argument is out of its range, or num_decisions no integer.
    """
    # In logarithms, which neither overflow nor cancel where delta is small and T large.
    is_certain = np.asarray(total_variation) == 1.0
    log_stay = np.log1p(-np.where(is_certain, 0.0, total_variation))
    return np.where(is_certain, 1.0, -np.expm1(num_decisions * log_stay))


def _density(points: Float[np.ndarray, "N M 2"], law: Displacement) -> Float[np.ndarray, "N M"]:
    centred = points - law.mean
    exponent = np.einsum("nmi,ij,nmj->nm", centred, np.linalg.inv(law.covariance), centred)
    return np.exp(-exponent / 2.0) / (2.0 * np.pi * math.sqrt(np.linalg.det(law.covariance)))


def _square_root(matrix: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "2 2"]:
    """Returns the symmetric square root of a positive semi-definite matrix."""
    values, vectors = np.linalg.eigh(matrix)  # rounding may leave a value just below 0
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
