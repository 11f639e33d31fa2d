"""Bounds on the value that a hierarchy loses, as the paper prints them and as they hold.

Paper, Sec. 3.1 and Appendix A. Symbols: k low-level steps per subgoal, gamma the discount per
low-level step, C the sum of gamma^i over a segment (k if its rewards aren't discounted), and H, the
span of the return, C * span / (1 - gamma^k). Proofs and counterexamples: docs/theory.md.

All arguments are numbers or arrays that broadcast. NumPy's are computed in float64; with JAX's, the
functions can be jitted and differentiated, and have the precision of their arguments.
"""

from typing import Any, Literal

from eihrl_jax.config import checks
from eihrl_jax.theory import arguments, segments

Numbers = arguments.Numbers
SegmentReward = segments.SegmentReward
Form = Literal["sharp", "linear"]
Variant = Literal["printed", "derived"]


def value_gap_bound(
    total_variation: Numbers,
    k: Any,
    gamma: Numbers,
    *,
    reward_span: Numbers = 1.0,
    value_span: Numbers | None = None,
    segment_reward: SegmentReward = "discounted",
    form: Form = "sharp",
) -> Any:
    """Bounds the sup-norm gap between the values of a flat policy and of a hierarchy.

    Args:
      total_variation: delta in [0, 1], the greatest total variation, over states, between the laws
        of the k-step path (states and actions) under the two.
      k: integers, at least 1, low-level steps per subgoal.
      gamma: in [0, 1), discount per low-level step.
      reward_span: greatest minus smallest reward of a step.
      value_span: H, the span of the return, if it is known; it takes the place of `reward_span`.
      segment_reward: whether rewards are discounted inside a segment (eq. 3) or only between
        segments (Sec. 2); without effect if `value_span` is given.
      form: "sharp": H delta / (1 - gamma^k (1 - delta)), attained for every k, gamma and delta;
        "linear": H delta / (1 - gamma^k), at least as great.

    Returns:
      The bound, in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: corrects the paper's Lemma A.2; Theorem 1 of docs/theory.md. It holds for optimal values
      too, with delta of the best high level (Theorem 2).

    >>> round(float(value_gap_bound(0.1, 1, 0.5)), 12)
    0.363636363636
    """
    delta = arguments.real("total_variation", total_variation, high=1.0)
    span = segments.value_span(k, gamma, reward_span, value_span, segment_reward)
    checks.one_of("form", form, ("sharp", "linear"))
    lost = segments.lost(k, gamma)
    return span * delta / (lost + (1.0 - lost) * delta if form == "sharp" else lost)


def endpoint_value_gap_bound(
    total_variation: Numbers,
    reward_gap: Numbers,
    k: Any,
    gamma: Numbers,
    *,
    reward_span: Numbers = 1.0,
    value_span: Numbers | None = None,
    segment_reward: SegmentReward = "discounted",
) -> Any:
    """Bounds the value gap from where segments end and what they pay, without their paths.

    Args:
      total_variation: eta in [0, 1], greatest total variation between the laws of the state after k
        steps.
      reward_gap: rho, greatest difference between the expected rewards of a segment.
      k: integers, at least 1.
      gamma: in [0, 1).
      reward_span: greatest minus smallest reward of a step.
      value_span: H if it is known.
      segment_reward: see `value_gap_bound`.

    Returns:
      (rho + gamma^k eta H) / (1 - gamma^k (1 - eta)), in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: corrects the paper's Lemma A.2; Theorem 1, endpoint form, of docs/theory.md.
    """
    eta = arguments.real("total_variation", total_variation, high=1.0)
    rho = arguments.real("reward_gap", reward_gap)
    span = segments.value_span(k, gamma, reward_span, value_span, segment_reward)
    lost = segments.lost(k, gamma)
    kept = 1.0 - lost
    return (rho + kept * eta * span) / (lost + kept * eta)


def optimal_value_gap_bound(
    imitation: Numbers,
    perturbation: Numbers,
    k: Any,
    gamma: Numbers,
    *,
    reward_span: Numbers = 1.0,
    value_span: Numbers | None = None,
    segment_reward: SegmentReward = "discounted",
) -> Any:
    """Bounds how much less the best high level earns than the best flat policy.

    Args:
      imitation: in [0, 1], delta*, greatest over states of the total variation between the paths of
        the best flat policy and of the subgoal that comes nearest to it.
      perturbation: in [0, 1], greatest over states and subgoals of the total variation between the
        paths of a subgoal as it is meant and as it is carried out.
      k: integers, at least 1.
      gamma: in [0, 1).
      reward_span: greatest minus smallest reward of a step.
      value_span: H if it is known.
      segment_reward: see `value_gap_bound`.

    Returns:
      The sum of the two bounds, at most H, in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: replaces the paper's Theorem A.4; Theorem 2 of docs/theory.md.
    """
    span = segments.value_span(k, gamma, reward_span, value_span, segment_reward)
    total = value_gap_bound(imitation, k, gamma, value_span=span)
    total = total + value_gap_bound(perturbation, k, gamma, value_span=span)
    return arguments.namespace(total, span).minimum(total, span)


def wasserstein_value_gap_bound(
    wasserstein: Numbers,
    value_lipschitz: Numbers,
    k: Any,
    gamma: Numbers,
    *,
    reward_gap: Numbers = 0.0,
) -> Any:
    """Bounds the gap between the optimal values of two sets of subgoals that end near each other.

    Args:
      wasserstein: w, greatest Wasserstein-1 distance between where matched subgoals end, units.
      value_lipschitz: Lipschitz constant of one of the two optimal values, per unit.
      k: integers, at least 1.
      gamma: in [0, 1).
      reward_gap: rho, greatest difference between the expected rewards of a segment.

    Returns:
      (rho + gamma^k Lambda w) / (1 - gamma^k), in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: replaces the paper's Theorem A.4; Theorem 3 of docs/theory.md.
    """
    distance = arguments.real("wasserstein", wasserstein)
    slope = arguments.real("value_lipschitz", value_lipschitz)
    rho = arguments.real("reward_gap", reward_gap)
    lost = segments.lost(k, gamma)
    return (rho + (1.0 - lost) * slope * distance) / lost


def displacement_value_gap_bound(
    bias: Numbers, std: Numbers, reward_lipschitz: Numbers, k: Any, gamma: Numbers
) -> Any:
    """Bounds what random displacements cost in free space, where a segment's end is rewarded.

    Args:
      bias: distance between mean displacement and subgoal, units.
      std: standard deviation per axis of the Gaussian displacement, units.
      reward_lipschitz: Lipschitz constant of the reward as a function of the end point, per unit.
      k: integers, at least 1.
      gamma: in [0, 1).

    Returns:
      L w / (1 - gamma^k)^2 with the mean length w of the error, see `rician_mean`.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: replaces "2 delta_max + 3 sqrt(2) epsilon" of the paper's eq. 11; corollary of Theorem 3
      of docs/theory.md. Walls inside the room break its assumption: measure the value's Lipschitz
      constant and use `wasserstein_value_gap_bound`.
    """
    slope = arguments.real("reward_lipschitz", reward_lipschitz)
    lost = segments.lost(k, gamma)
    return slope * rician_mean(bias, std) / lost**2


def published_hierarchy_bound(
    mismatch: Numbers, k: Any, gamma: Numbers, *, r_max: Numbers = 1.0, variant: Variant = "printed"
) -> Any:
    """Computes the paper's Lemma A.2: a printed formula, not a valid bound in general.

    Args:
      mismatch: nu in [0, 2], at most 1 as a maximum norm, at most 2 as an L1 norm.
      k: integers, at least 1.
      gamma: in [0, 1).
      r_max: greatest reward.
      variant: "printed": eq. 5 and 9, without the factor k that their derivation has; "derived":
        eq. 24. With nu the L1 distance of path laws and rewards from 0 to `r_max`, "derived" holds;
        "printed" holds for k = 1 only, and for small gamma.

    Returns:
      The formula's value, in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: paper, eq. 5, 9 and 24.
    """
    nu = arguments.real("mismatch", mismatch, high=2.0)
    reward = arguments.real("r_max", r_max)
    return _published(nu, k, gamma, reward, variant)


def published_subgoal_bound(
    lipschitz: Numbers,
    max_displacement: Numbers,
    epsilon: Numbers,
    k: Any,
    gamma: Numbers,
    *,
    r_max: Numbers = 1.0,
    variant: Variant = "printed",
) -> Any:
    """Computes the paper's Theorem A.4: a printed formula, not a valid bound in general.

    Args:
      lipschitz: L_phi of Assumption A.3, per unit.
      max_displacement: delta_max, units.
      epsilon: bound on the standard deviation per axis, units.
      k: integers, at least 1.
      gamma: in [0, 1).
      r_max: greatest reward.
      variant: "printed": eq. 6 and 11; "derived": with the factor k restored.

    Returns:
      The formula's value with nu = L (2 delta_max + 3 sqrt(2) epsilon), in units of the return.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: paper, eq. 6 and 11.
    """
    slope = arguments.real("lipschitz", lipschitz)
    displacement = arguments.real("max_displacement", max_displacement)
    noise = arguments.real("epsilon", epsilon)
    reward = arguments.real("r_max", r_max)
    nu = slope * (2.0 * displacement + 3.0 * 2.0**0.5 * noise)
    return _published(nu, k, gamma, reward, variant)


def max_norm_to_total_variation(mismatch: Numbers, outcomes: Any) -> Any:
    """Bounds a total variation by the maximum norm that the paper uses instead.

    Args:
      mismatch: in [0, 1], greatest difference between the probabilities of one outcome.
      outcomes: integers, at least 1, number n of outcomes.

    Returns:
      min(1, nu floor(n / 2)), attained for every n.

    Raises:
      ValueError, TypeError: an argument is out of its range, or outcomes no integer.
    """
    nu = arguments.real("mismatch", mismatch, high=1.0)
    num = arguments.count("outcomes", outcomes)
    xp = arguments.namespace(nu, num)
    return xp.minimum(1.0, nu * xp.floor(num / 2.0))


def gaussian_total_variation(mean_shift: Numbers, std: Numbers) -> Any:
    """Computes the total variation between two Gaussians of equal covariance.

    Args:
      mean_shift: distance between the means, units.
      std: standard deviation per axis, units, positive.

    Returns:
      erf(shift / (2 sqrt(2) std)), in any dimension.

    Raises:
      ValueError: an argument is out of its range.
    """
    shift, scale = arguments.real("mean_shift", mean_shift), arguments.positive("std", std)
    return arguments.special(shift, scale).erf(shift / scale / 8.0**0.5)


def gaussian_scale_total_variation(std_a: Numbers, std_b: Numbers) -> Any:
    """Computes the total variation between isotropic Gaussians in the plane with equal means.

    Args:
      std_a: standard deviation per axis of one, units, positive.
      std_b: of the other.

    Returns:
      (1 - a) a^(a / (1 - a)) with a the smaller variance divided by the greater.

    Raises:
      ValueError: an argument is out of its range.
    """
    first, second = arguments.positive("std_a", std_a), arguments.positive("std_b", std_b)
    xp = arguments.namespace(first, second)
    small, large = xp.minimum(first, second), xp.maximum(first, second)
    ratio = small / large
    apart = (large - small) / large * (1.0 + ratio)  # 1 - a without cancellation
    near = xp.where(apart < 0.5, apart, 0.5)
    log_a = xp.where(apart < 0.5, xp.log1p(-near), 2.0 * xp.log(ratio))
    power = xp.exp(ratio**2 / xp.where(apart > 0.0, apart, 1.0) * log_a)
    return xp.where(apart > 0.0, apart * power, 0.0)


def rician_mean(shift: Numbers, std: Numbers) -> Any:
    """Computes the mean length of a vector in the plane with Gaussian noise.

    Args:
      shift: length of its mean, units.
      std: standard deviation per axis, units; with 0 the mean length is `shift`.

    Returns:
      std sqrt(pi / 2) ((1 + t) I0e(t / 2) + t I1e(t / 2)), t = shift^2 / (2 std^2), units.

    Raises:
      ValueError: an argument is out of its range.
    """
    mean, scale = arguments.real("shift", shift), arguments.real("std", std)
    xp, special = arguments.namespace(mean, scale), arguments.special(mean, scale)
    is_noisy = scale > 1e-4 * mean  # below, three terms of the series are exact
    some = xp.where(is_noisy, scale, 1.0)
    t = (xp.where(is_noisy, mean, 0.0) / some) ** 2 / 2.0
    bessel = (1.0 + t) * special.i0e(t / 2.0) + t * special.i1e(t / 2.0)
    length = xp.where(is_noisy | (mean == 0.0), 1.0, mean)
    ratio = xp.where(is_noisy, 0.0, scale) / length
    series = mean * (1.0 + ratio**2 / 2.0 + ratio**4 / 8.0)
    return xp.where(is_noisy, some * (xp.pi / 2.0) ** 0.5 * bessel, series)


def rayleigh_cdf(radius: Numbers, std: Numbers) -> Any:
    """Computes how likely Gaussian noise in the plane is no longer than a radius.

    Args:
      radius: units.
      std: standard deviation per axis, units; with 0 the answer is 1.

    Returns:
      1 - exp(-radius^2 / (2 std^2)).

    Raises:
      ValueError: an argument is out of its range.
    """
    length, scale = arguments.real("radius", radius), arguments.real("std", std)
    xp = arguments.namespace(length, scale)
    some = xp.where(scale > 0.0, scale, 1.0)
    return xp.where(scale > 0.0, -xp.expm1(-((length / some) ** 2) / 2.0), 1.0)


def rayleigh_quantile(level: Numbers, std: Numbers, *, segments: Any = 1) -> Any:
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
    probability = arguments.real("level", level, below=1.0)
    scale = arguments.real("std", std)
    num = arguments.count("segments", segments)
    xp = arguments.namespace(probability, scale, num)
    some = xp.where(probability > 0.0, probability, 0.5)
    log_each = xp.log(some) / num
    likely, unlikely = xp.maximum(log_each, -1.0), xp.minimum(log_each, -1.0)
    # Two forms, each exact where it is used.
    outside = xp.where(log_each > -1.0, xp.log(-xp.expm1(likely)), xp.log1p(-xp.exp(unlikely)))
    return xp.where(probability > 0.0, scale * xp.sqrt(-2.0 * outside), 0.0)


def _published(nu: Any, k: Any, gamma: Numbers, r_max: Any, variant: Variant) -> Any:
    """Eq. 9 ("printed") or eq. 24 ("derived")."""
    checks.one_of("variant", variant, ("printed", "derived"))
    lost, num = segments.lost(k, gamma), arguments.count("k", k)
    if variant == "derived":
        return nu * num * r_max / (2.0 * lost**2)
    return nu * r_max / (2.0 * lost) * (num + (1.0 - lost) / lost)
