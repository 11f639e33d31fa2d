"""Laws of Gaussian noise: how far apart two are, and how long noise in the plane is.

Arguments are numbers or arrays that broadcast; they are computed in float64.
"""

import numpy as np
from scipy import special

from eihrl_jax.theory import arguments
from eihrl_jax.theory.arguments import Counts, Discounts, Floats, NonNegatives, Positives


@arguments.checked
def total_variation(mean_shift: NonNegatives, std: Positives) -> Floats:
    """Computes the total variation between two Gaussians of equal covariance.

    Args:
      mean_shift: distance between the means, units.
      std: standard deviation per axis, units, positive.

    Returns:
      erf(shift / (2 sqrt(2) std)), in any dimension.

    Raises:
      ValueError: an argument is out of its range.
    """
    # The densities cross halfway between the means: P(|N(0, 1)| < shift / (2 std)).
    return special.erf(mean_shift / std / 8.0**0.5)


@arguments.checked
def scale_total_variation(std_a: Positives, std_b: Positives) -> Floats:
    """Computes the total variation between isotropic Gaussians in the plane with equal means.

    Args:
      std_a: standard deviation per axis of one, units, positive.
      std_b: of the other.

    Returns:
      (1 - a) a^(a / (1 - a)) with a the smaller variance divided by the greater.

    Raises:
      ValueError: an argument is out of its range.
    """
    small, large = np.minimum(std_a, std_b), np.maximum(std_a, std_b)
    ratio = small / large
    apart = (large - small) / large * (1.0 + ratio)  # 1 - a without cancellation
    # log(a), again without cancellation where a is near 1.
    near = np.where(apart < 0.5, apart, 0.5)
    log_a = np.where(apart < 0.5, np.log1p(-near), 2.0 * np.log(ratio))
    power = np.exp(ratio**2 / np.where(apart > 0.0, apart, 1.0) * log_a)
    return np.where(apart > 0.0, apart * power, 0.0)


@arguments.checked
def rician_mean(shift: NonNegatives, std: NonNegatives) -> Floats:
    """Computes the mean length of a vector in the plane with Gaussian noise.

    Args:
      shift: length of its mean, units.
      std: standard deviation per axis, units; with 0 the mean length is `shift`.

    Returns:
      std sqrt(pi / 2) ((1 + t) I0e(t / 2) + t I1e(t / 2)), t = shift^2 / (2 std^2), units.

    Raises:
      ValueError: an argument is out of its range.
    """
    is_noisy = np.asarray(std > 1e-4 * shift)
    scale = np.where(is_noisy, std, 1.0)
    t = (np.where(is_noisy, shift, 0.0) / scale) ** 2 / 2.0
    bessel = (1.0 + t) * special.i0e(t / 2.0) + t * special.i1e(t / 2.0)

    # Where there is hardly any noise t overflows, and three terms of the series are exact.
    length = np.where(is_noisy | (shift == 0.0), 1.0, shift)
    ratio = np.where(is_noisy, 0.0, std) / length
    series = shift * (1.0 + ratio**2 / 2.0 + ratio**4 / 8.0)
    return np.where(is_noisy, scale * (np.pi / 2.0) ** 0.5 * bessel, series)


@arguments.checked
def rayleigh_cdf(radius: NonNegatives, std: NonNegatives) -> Floats:
    """Computes how likely Gaussian noise in the plane is no longer than a radius.

    Args:
      radius: units.
      std: standard deviation per axis, units; with 0 the answer is 1.

    Returns:
      1 - exp(-radius^2 / (2 std^2)).

    Raises:
      ValueError: an argument is out of its range.
    """
    is_noisy = np.asarray(std) > 0.0
    scale = np.where(is_noisy, std, 1.0)
    return np.where(is_noisy, -np.expm1(-((radius / scale) ** 2) / 2.0), 1.0)


@arguments.checked
def rayleigh_quantile(level: Discounts, std: NonNegatives, *, segments: Counts = 1) -> Floats:
    """Computes the radius that noise in the plane stays within, in all of several segments.

    Args:
      level: in [0, 1), probability with which it does.
      std: standard deviation per axis, units.
      segments: integers, at least 1, independent segments.

    Returns:
      std sqrt(-2 log(1 - level^(1 / segments))), units.

    Raises:
      ValueError, TypeError: an argument is out of its range, or segments no integer.
    """
    # Independent segments: each must stay within with the root of the level.
    is_possible = np.asarray(level) > 0.0
    log_each = np.log(np.where(is_possible, level, 0.5)) / segments

    # log(1 - e^x) in two forms, each exact where it is used.
    likely, unlikely = np.maximum(log_each, -1.0), np.minimum(log_each, -1.0)
    outside = np.where(log_each > -1.0, np.log(-np.expm1(likely)), np.log1p(-np.exp(unlikely)))
    return np.where(is_possible, std * np.sqrt(-2.0 * outside), 0.0)
