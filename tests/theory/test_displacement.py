import math

import numpy as np
import pytest
from scipy import stats

from eihrl_jax.theory import displacement, gaussians

OF = displacement.Displacement.of


def test_shift_and_scale_agree_with_closed_forms():
    """Equal covariances: the error function; equal means, isotropic: the planar scale formula."""
    shifted = displacement.total_variation(OF(3.0, 0.3), OF(3.2, 0.3))
    assert shifted == pytest.approx(gaussians.total_variation(0.2, 0.3), abs=1e-5)
    scaled = displacement.total_variation(OF(3.0, 0.3), OF(3.0, 0.2))
    assert scaled == pytest.approx(gaussians.scale_total_variation(0.3, 0.2), abs=1e-5)


def test_anisotropic_laws_against_sampling():
    """TV = E_p max(0, 1 - q/p), by Monte Carlo with SciPy's densities."""
    first = OF(3.0, 0.3, 0.1, 0.2, 0.5)
    second = OF(2.8, 0.25, 0.0, 0.3, -0.2)
    laws = [stats.multivariate_normal(law.mean, law.covariance) for law in (first, second)]
    points = laws[0].rvs(200_000, random_state=0)
    expected = np.maximum(0.0, 1.0 - laws[1].pdf(points) / laws[0].pdf(points)).mean()
    found = displacement.total_variation(first, second)
    assert found == pytest.approx(expected, abs=4e-3)
    assert found == pytest.approx(displacement.total_variation(second, first), abs=1e-9)
    assert displacement.total_variation(first, first) == 0.0


def test_narrow_law_shares_almost_nothing():
    assert displacement.total_variation(OF(3.0, 0.3), OF(3.0, 0.01)) > 0.99


def test_wasserstein_bound_of_shift_and_scale():
    """A pure shift costs its length; equal means and axes, the distance of the deviations."""
    assert displacement.wasserstein_bound(OF(3.0, 0.3), OF(2.5, 0.3)) == pytest.approx(0.5)
    found = displacement.wasserstein_bound(OF(3.0, 0.3, 0.0, 0.1), OF(3.0, 0.1, 0.0, 0.2))
    assert found == pytest.approx(math.hypot(0.2, 0.1))


def test_success_gap_is_the_chance_to_part():
    """Against the product over decisions, written out; certain where the laws share nothing."""
    stay = 1.0
    for _ in range(24):
        stay *= 1.0 - 0.03
    assert displacement.success_gap_bound(0.03, 24) == pytest.approx(1.0 - stay, rel=1e-12)
    assert displacement.success_gap_bound(1.0, 1) == 1.0
    assert displacement.success_gap_bound(0.0, 200) == 0.0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((3.0, 0.0), ["along_std", "0"]),
        ((3.0, 0.3, 0.0, -0.1), ["lateral_std", "-0.1"]),
        ((3.0, 0.3, 0.0, 0.3, 1.0), ["correlation", "1.0"]),
        ((math.nan, 0.3), ["along_mean", "nan"]),
    ],
)
def test_bad_laws_are_named(values, words):
    with pytest.raises(ValueError) as error:
        OF(*values)
    assert all(word in str(error.value) for word in words)


def test_bad_limits_are_named():
    with pytest.raises(ValueError, match="total_variation = 1.5"):
        displacement.success_gap_bound(1.5, 24)
    with pytest.raises(TypeError, match="num_decisions"):
        displacement.success_gap_bound(0.5, 2.5)
