"""Bounds on the value that a hierarchy loses, as the paper prints them and as they hold.

Paper, Sec. 3.1 and Appendix A. Symbols: k low-level steps per subgoal, gamma the discount per
low-level step, C the sum of gamma^i over a segment (k if its rewards aren't discounted), and H, the
span of the return, C * span / (1 - gamma^k). Proofs and counterexamples: docs/theory.md.

All arguments are numbers or arrays that broadcast; they are computed in float64.
"""

from typing import Literal

import numpy as np

from eihrl_jax.theory import arguments, gaussians, segments
from eihrl_jax.theory.arguments import (
    Counts,
    Discounts,
    Floats,
    Integers,
    L1Norms,
    NonNegatives,
    Shares,
)
from eihrl_jax.theory.segments import SegmentReward

Form = Literal["sharp", "linear"]
Variant = Literal["printed", "derived"]


@arguments.checked
def value_gap_bound(
    total_variation: Shares,
    k: Counts,
    gamma: Discounts,
    *,
    reward_span: NonNegatives = 1.0,
    value_span: NonNegatives | None = None,
    segment_reward: SegmentReward = "discounted",
    form: Form = "sharp",
) -> Floats:
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
    span = segments.value_span(k, gamma, reward_span, value_span, segment_reward)
    lost = segments.lost(k, gamma)
    # Theorem 1: of the later segments only those part whose paths were the same so far.
    kept = (1.0 - lost) * total_variation if form == "sharp" else 0.0
    return span * total_variation / (lost + kept)


@arguments.checked
def endpoint_value_gap_bound(
    total_variation: Shares,
    reward_gap: NonNegatives,
    k: Counts,
    gamma: Discounts,
    *,
    reward_span: NonNegatives = 1.0,
    value_span: NonNegatives | None = None,
    segment_reward: SegmentReward = "discounted",
) -> Floats:
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
    span = segments.value_span(k, gamma, reward_span, value_span, segment_reward)
    lost = segments.lost(k, gamma)
    # Theorem 1, endpoint form: gamma^k eta.
    kept = (1.0 - lost) * total_variation
    return (reward_gap + kept * span) / (lost + kept)


@arguments.checked
def optimal_value_gap_bound(
    imitation: Shares,
    perturbation: Shares,
    k: Counts,
    gamma: Discounts,
    *,
    reward_span: NonNegatives = 1.0,
    value_span: NonNegatives | None = None,
    segment_reward: SegmentReward = "discounted",
) -> Floats:
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
    # Theorem 2: first to the best subgoal as it is meant, then to how it is carried out.
    total = sum(value_gap_bound(d, k, gamma, value_span=span) for d in (imitation, perturbation))
    return np.minimum(total, span)


@arguments.checked
def wasserstein_value_gap_bound(
    wasserstein: NonNegatives,
    value_lipschitz: NonNegatives,
    k: Counts,
    gamma: Discounts,
    *,
    reward_gap: NonNegatives = 0.0,
) -> Floats:
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
    # Theorem 3, by duality: a Lipschitz value changes by no more than the distance of the ends.
    lost = segments.lost(k, gamma)
    return (reward_gap + (1.0 - lost) * value_lipschitz * wasserstein) / lost


@arguments.checked
def displacement_value_gap_bound(
    bias: NonNegatives,
    std: NonNegatives,
    reward_lipschitz: NonNegatives,
    k: Counts,
    gamma: Discounts,
) -> Floats:
    """Bounds what random displacements cost in free space, where a segment's end is rewarded.

    Args:
      bias: distance between mean displacement and subgoal, units.
      std: standard deviation per axis of the Gaussian displacement, units.
      reward_lipschitz: Lipschitz constant of the reward as a function of the end point, per unit.
      k: integers, at least 1.
      gamma: in [0, 1).

    Returns:
      L w / (1 - gamma^k)^2 with the mean length w of the error, see `gaussians.rician_mean`.

    Raises:
      ValueError, TypeError: an argument is out of its range, or k no integer.

    Source: replaces "2 delta_max + 3 sqrt(2) epsilon" of the paper's eq. 11; corollary of Theorem 3
      of docs/theory.md. Walls inside the room break its assumption: measure the value's Lipschitz
      constant and use `wasserstein_value_gap_bound`.
    """
    # Theorem 3 with rho = L w, and the value's Lipschitz constant that follows, L / (1 - gamma^k).
    return reward_lipschitz * gaussians.rician_mean(bias, std) / segments.lost(k, gamma) ** 2


@arguments.checked
def published_hierarchy_bound(
    mismatch: L1Norms,
    k: Counts,
    gamma: Discounts,
    *,
    r_max: NonNegatives = 1.0,
    variant: Variant = "printed",
) -> Floats:
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
    return _published(mismatch, k, gamma, r_max, variant)


@arguments.checked
def published_subgoal_bound(
    lipschitz: NonNegatives,
    max_displacement: NonNegatives,
    epsilon: NonNegatives,
    k: Counts,
    gamma: Discounts,
    *,
    r_max: NonNegatives = 1.0,
    variant: Variant = "printed",
) -> Floats:
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
    # Paper: eq. 11, with the noise bounded by three standard deviations per axis.
    nu = lipschitz * (2.0 * max_displacement + 3.0 * 2.0**0.5 * epsilon)
    return _published(nu, k, gamma, r_max, variant)


@arguments.checked
def max_norm_to_total_variation(mismatch: Shares, outcomes: Counts) -> Floats:
    """Bounds a total variation by the maximum norm that the paper uses instead.

    Args:
      mismatch: in [0, 1], greatest difference between the probabilities of one outcome.
      outcomes: integers, at least 1, number n of outcomes.

    Returns:
      min(1, nu floor(n / 2)), attained for every n.

    Raises:
      ValueError, TypeError: an argument is out of its range, or outcomes no integer.
    """
    # Half of the outcomes may gain what the other half loses.
    return np.minimum(1.0, mismatch * (outcomes // 2))


def _published(nu: Floats, k: Integers, gamma: Floats, r_max: Floats, variant: Variant) -> Floats:
    """Returns eq. 9 ("printed") or eq. 24 ("derived")."""
    lost = segments.lost(k, gamma)
    if variant == "derived":
        return nu * k * r_max / (2.0 * lost**2)
    # Paper: eq. 9, whose second term lacks the factor k of its derivation.
    return nu * r_max / (2.0 * lost) * (k + (1.0 - lost) / lost)
