"""What k low-level steps under one subgoal discount, and the span of the return."""

from typing import Literal

import numpy as np

from eihrl_jax.theory.arguments import Floats, Integers

SegmentReward = Literal["discounted", "undiscounted"]
"""Whether rewards are discounted inside a segment (paper, eq. 3), or only between them (Sec. 2)."""


def lost(k: Integers, gamma: Floats) -> Floats:
    """Returns 1 - gamma^k to full precision, also where gamma comes near 1."""
    # 1 - gamma^k cancels near 1, and log(gamma) doesn't exist at 0: each form where it is exact.
    is_near_one = np.asarray(gamma) > 0.5
    inside = np.where(is_near_one, gamma, 1.0)
    return np.where(is_near_one, -np.expm1(k * np.log(inside)), 1.0 - gamma**k)


def value_span(
    k: Integers,
    gamma: Floats,
    reward_span: Floats,
    value_span: Floats | None,
    segment_reward: SegmentReward,
) -> Floats:
    """Returns H: `value_span` if it is given, else that of rewards with a span of `reward_span`."""
    if value_span is not None:
        return value_span
    if segment_reward == "undiscounted":
        return k * reward_span / lost(k, gamma)
    return reward_span / (1.0 - gamma)  # C / (1 - gamma^k), whatever k
