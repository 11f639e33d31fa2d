"""What k low-level steps under one subgoal discount, and the span of the return."""

from typing import Any, Literal

from eihrl_jax.config import checks
from eihrl_jax.theory import arguments

SegmentReward = Literal["discounted", "undiscounted"]
"""Whether rewards are discounted inside a segment (paper, eq. 3), or only between them (Sec. 2)."""


def lost(k: Any, gamma: arguments.Numbers) -> Any:
    """Returns 1 - gamma^k to full precision, also where gamma comes near 1."""
    num, discount = arguments.count("k", k), arguments.real("gamma", gamma, below=1.0)
    xp = arguments.namespace(num, discount)
    inside = xp.where(discount > 0.5, discount, 1.0)
    result = xp.where(discount > 0.5, -xp.expm1(num * xp.log(inside)), 1.0 - discount**num)
    is_plain = isinstance(num, float) and isinstance(discount, float)
    return float(result) if is_plain else result  # a number stays weakly typed


def value_span(
    k: Any,
    gamma: arguments.Numbers,
    reward_span: Any,
    value_span: Any,
    segment_reward: SegmentReward,
) -> Any:
    """Returns H: `value_span` if it is given, else that of rewards with a span of `reward_span`."""
    checks.one_of("segment_reward", segment_reward, ("discounted", "undiscounted"))
    if value_span is not None:
        return arguments.real("value_span", value_span)
    span = arguments.real("reward_span", reward_span)
    if segment_reward == "undiscounted":
        return arguments.count("k", k) * span / lost(k, gamma)
    return span / (1.0 - arguments.real("gamma", gamma, below=1.0))
