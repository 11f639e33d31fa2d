"""Laws of Gaussian noise in the plane against quadrature, and where their formulas could cancel."""

import math

import numpy as np
import pytest
from scipy import integrate, stats

from eihrl_jax.theory import gaussians


def close(expected, digits):
    """What equals a rounded number to all its digits after the point."""
    return pytest.approx(expected, rel=1e-13, abs=0.51 * 10.0**-digits)


@pytest.mark.parametrize(("shift", "std", "expected"), [
    (0.5, 1.0, 0.197412651366),
    (1.0, 1.0, 0.382924922548),
    (0.3, 0.1, 0.866385597462),
    (2.0, 0.5, 0.954499736104),
])  # fmt: skip
def test_total_variation_of_shifted_gaussians_is_an_integral(shift, std, expected):
    first, second = stats.norm(0.0, std), stats.norm(shift, std)
    integral, _ = integrate.quad(
        lambda x: abs(first.pdf(x) - second.pdf(x)) / 2.0,
        -9.0 * std,
        shift + 9.0 * std,
        points=[shift / 2.0],
        epsabs=1e-12,
    )
    found = gaussians.total_variation(shift, std)
    assert found == close(expected, 12)
    assert found == pytest.approx(integral, abs=1e-10)


@pytest.mark.parametrize(("first", "second", "expected"), [
    (0.5, 1.0, 0.472470393711),
    (0.9, 1.0, 0.077376803858),
    (0.1, 1.0, 0.945002972095),
    (3.0, 2.0, None),
    (1e-3, 0.1, None),
])  # fmt: skip
def test_total_variation_of_scaled_gaussians_is_an_integral_over_the_radius(
    first, second, expected
):
    def apart(radius):
        densities = [math.exp(-0.5 * (radius / s) ** 2) / s**2 for s in (first, second)]
        return radius * abs(densities[0] - densities[1]) / 2.0

    ratio = (first / second) ** 2
    crossing = first * math.sqrt(2.0 * math.log(ratio) / (ratio - 1.0))
    parts = [
        integrate.quad(apart, 0.0, crossing, epsabs=1e-13)[0],
        integrate.quad(apart, crossing, 12.0 * max(first, second), epsabs=1e-13, limit=200)[0],
    ]
    found = gaussians.scale_total_variation(first, second)
    assert found == pytest.approx(sum(parts), abs=1e-10)
    assert expected is None or found == close(expected, 12)


def test_scaled_gaussians_from_equal_to_utterly_different():
    tv = gaussians.scale_total_variation
    assert tv(0.7, 0.7) == 0.0
    # a = 1 - 2e for a ratio of 1 - e, and TV = (1 - a) / exp(1) to first order.
    assert tv(1.0 - 1e-12, 1.0) == pytest.approx(2e-12 / math.e, rel=1e-4)
    assert tv(1.0, 1.0 + 2**-40) == pytest.approx(2 * 2**-40 / math.e, rel=1e-10)
    np.testing.assert_allclose(tv(np.array([1e-9, 1e-200]), 1.0), 1.0, rtol=1e-15)


@pytest.mark.parametrize(("shift", "std"), [(0.0, 0.1), (0.1, 0.1), (0.5, 0.3), (2.0, 0.4), (1, 3)])
def test_mean_length_is_an_integral_over_the_plane(shift, std):
    def share(angle, radius):
        length = math.sqrt(shift**2 + radius**2 + 2.0 * shift * radius * math.cos(angle))
        return length * radius / std**2 * math.exp(-0.5 * (radius / std) ** 2) / math.pi

    integral, _ = integrate.dblquad(share, 0.0, 9.0 * std, 0.0, math.pi, epsabs=1e-9, epsrel=1e-9)
    found = gaussians.rician_mean(shift, std)
    assert found == pytest.approx(integral, abs=1e-8)
    assert max(shift, std * math.sqrt(math.pi / 2)) <= found <= math.sqrt(shift**2 + 2 * std**2)


@pytest.mark.parametrize("shift", [1e-120, 0.3, 1e6])
def test_mean_length_is_continuous_where_its_series_begins(shift):
    stds = 1e-4 * shift * np.array([0.5, 1.0 - 1e-9, 1.0 + 1e-9, 2.0])
    excess = (
        gaussians.rician_mean(shift, stds) / shift - 1.0
    )  # e^2 / 2 + e^4 / 8 for e = std / shift
    np.testing.assert_allclose(excess, (stds / shift) ** 2 / 2.0, rtol=1e-6, atol=1e-15)


def test_mean_length_without_noise_or_without_shift():
    np.testing.assert_array_equal(
        gaussians.rician_mean(np.array([0.0, 0.3, 4.0]), 0.0), [0, 0.3, 4.0]
    )
    rayleigh = math.sqrt(math.pi / 2.0)
    assert gaussians.rician_mean(0.0, 2.0) == pytest.approx(2.0 * rayleigh, rel=1e-15)
    assert gaussians.rician_mean(1e-120, 1.0) == pytest.approx(rayleigh, rel=1e-15)
    assert gaussians.rician_mean(0.0, 1e100) == pytest.approx(1e100 * rayleigh, rel=1e-15)


@pytest.mark.parametrize(
    ("radius", "expected"),
    [(1, 0.3934693403), (2, 0.8646647168), (3, 0.9888910035), (3 * 2**0.5, 0.9998765902)],
)
def test_rayleigh_cdf_is_an_integral_over_a_disc(radius, expected):
    def strip(x):
        return stats.norm.pdf(x) * (2.0 * stats.norm.cdf(math.sqrt(radius**2 - x**2)) - 1.0)

    assert gaussians.rayleigh_cdf(radius, 1.0) == close(expected, 10)
    integral = 2.0 * integrate.quad(strip, 0.0, radius)[0]
    assert gaussians.rayleigh_cdf(0.7 * radius, 0.7) == pytest.approx(integral, abs=1e-9)
    np.testing.assert_array_equal(gaussians.rayleigh_cdf(np.array([0.0, 2.0]), 0.0), 1.0)


@pytest.mark.parametrize(
    ("level", "segments", "expected"),
    [
        (0.5, 1, 1.177410022515),
        (0.9, 1, 2.145966026289),
        (0.95, 1, 2.447746830681),
        (0.99, 1, 3.034854258770),
        (0.95, 40, 3.649579647253),
    ],
)
def test_rayleigh_quantile(level, segments, expected):
    found = gaussians.rayleigh_quantile(level, 1.0, segments=segments)
    assert found == close(expected, 12)
    assert gaussians.rayleigh_cdf(3.0 * found, 3.0) ** segments == pytest.approx(level, rel=1e-12)


def test_rayleigh_quantile_of_hardly_any_probability():
    level = np.array([0.0, 1e-300, 1e-20, 1e-8])
    expected = np.sqrt(2.0 * level) * (1.0 + level / 4.0)  # of -log(1 - p) = p + p^2 / 2 + ...
    np.testing.assert_allclose(gaussians.rayleigh_quantile(level, 1.0), expected, rtol=1e-13)
