"""How far a hierarchy is from a flat policy, in every reading of the paper's nu, and the bounds.

Paper, Definition A.1 and Lemma A.2. Problems may have leading axes, for many MDPs at once; numbers
have the same.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from eihrl_jax.theory import arguments, bounds, tabular
from eihrl_jax.theory.arguments import Count, Discount, Floats
from eihrl_jax.theory.problem import Problem


@dataclasses.dataclass(frozen=True, kw_only=True)
class Mismatch:
    """Readings of nu, each the greatest over states; probabilities unless said otherwise.

    Attributes:
      literal: eq. 8 as printed: |P(s' | s) - high(g | s) P(s' | s, g)|, greatest over g and s' too.
      endpoint_max: eq. 16: of the state after k steps, maximum norm.
      endpoint_total_variation: of the state after k steps, half the L1 norm.
      path_max: of the path of states and actions, maximum norm.
      path_total_variation: of the path, half the L1 norm.
      reward_gap: greatest difference between the expected rewards of a segment.
    """

    literal: Floats
    endpoint_max: Floats
    endpoint_total_variation: Floats
    path_max: Floats
    path_total_variation: Floats
    reward_gap: Floats


@dataclasses.dataclass(frozen=True, kw_only=True)
class BoundCheck:
    """What a hierarchy loses, and what bounds say about it.

    Attributes:
      gap: greatest difference between the values of the two policies over states.
      bounds: by name; those that start with "printed" or "derived" are the paper's eq. 9 and 24.
      holds: by name, whether the gap is no greater, up to rounding.
    """

    gap: Floats
    bounds: dict[str, Floats]
    holds: dict[str, Bool[np.ndarray, "..."] | np.bool_]


@arguments.checked
def agreement(problem: Problem, k: Count) -> Float[np.ndarray, "... G S"]:
    """Computes the mass that the k-step paths of both have in common at least: float64 [..., G, S].

    One minus it bounds the total variation of the paths of the flat policy and of a subgoal; the
    two are equal if the flat policy is deterministic.

    Args:
      problem: whose high level doesn't matter.
      k: at least 1.

    Raises:
      ValueError: an array has a wrong shape or value.
      TypeError: k isn't an integer.

    Source: docs/theory.md, corollary of Theorem 1.
    """
    p = problem.checked()
    common = np.minimum(p.flat[..., None, :, :], p.low)
    kernel = np.einsum("...gsa,...sat->...gst", common, p.transition)
    # Mass is lost wherever the two policies differ, in every step anew.
    mass = np.ones(kernel.shape[:-1])
    for _ in range(k):
        mass = (kernel @ mass[..., None])[..., 0]
    return mass


@arguments.checked
def path_total_variation(
    problem: Problem, k: Count, *, max_paths: int = 10**6
) -> Float[np.ndarray, "... S"]:
    """Computes the total variation between the laws of the k-step paths by enumerating them.

    Args:
      problem: both policies.
      k: at least 1.
      max_paths: limit on the number of paths from all states of one MDP, S A (S A)^(k - 1); the
        last state needn't be enumerated.

    Returns:
      float64 [..., S], by the state in which the path starts.

    Raises:
      ValueError: an array has a wrong shape or value, or there are too many paths.
      TypeError: k isn't an integer.
    """
    return _path_distances(problem.checked(), k, max_paths)[0]


@arguments.checked
def mismatch(problem: Problem, k: Count, gamma: Discount) -> Mismatch:
    """Computes every reading of nu, with rewards discounted inside segments.

    Args:
      problem: both policies.
      k: at least 1.
      gamma: in [0, 1).

    Raises:
      ValueError: an argument has a wrong shape or value, or there are too many paths.
      TypeError: k isn't an integer.
    """
    kernel, rewards = tabular.k_step_model(problem, k, gamma)
    kernels, option_rewards = tabular.option_models(problem, k, gamma)
    p = problem.checked()
    mixed, mixed_rewards = tabular.mix(kernels, option_rewards, p.high)

    ends = np.abs(kernel - mixed)
    weighted = np.swapaxes(p.high, -2, -1)[..., None] * kernels  # [..., G, S, S]
    total, greatest = _path_distances(p, k, 10**6)
    return Mismatch(
        literal=np.abs(kernel[..., None, :, :] - weighted).max((-3, -2, -1)),
        endpoint_max=ends.max((-2, -1)),
        endpoint_total_variation=ends.sum(-1).max(-1) / 2.0,
        path_max=greatest.max(-1),
        path_total_variation=total.max(-1),
        reward_gap=np.abs(rewards - mixed_rewards).max(-1),
    )


@arguments.checked
def check_bounds(problem: Problem, k: Count, gamma: Discount) -> BoundCheck:
    """Compares what a hierarchy loses against a flat policy with every bound.

    Args:
      problem: whose rewards are at least 0: the published formulas know no others.
      k: at least 1.
      gamma: in [0, 1).

    Returns:
      Gap and bounds, each [...]: Theorem 1 with the paths' total variation ("path"), linearised
      ("path, linear"), with the common mass in its place ("agreement"), with ends and rewards of
      segments ("endpoint"), from single steps ("one step"); the published ones by reading of nu.

    Raises:
      ValueError: an argument has a wrong shape or value, or there are too many paths.
      TypeError: k isn't an integer.
    """
    reward = problem.checked().reward
    if (reward < 0.0).any():
        raise ValueError(f"reward = {reward.min()} must be at least 0")

    values = tabular.policy_value(problem, gamma), tabular.hierarchical_value(problem, k, gamma)
    gap = np.abs(values[0] - values[1]).max(-1)
    nu = mismatch(problem, k, gamma)
    limits = _corrected(problem.checked(), k, gamma, nu)
    # Eq. 9 and 24 take nu in whatever norm; an L1 norm is twice a total variation.
    readings = {
        "literal": nu.literal,
        "endpoint max": nu.endpoint_max,
        "endpoint L1": 2.0 * nu.endpoint_total_variation,
        "path max": nu.path_max,
        "path L1": 2.0 * nu.path_total_variation,
    }
    for variant in ("printed", "derived"):
        for reading, rate in readings.items():
            limits[f"{variant}, {reading}"] = bounds.published_hierarchy_bound(
                np.minimum(rate, 2.0), k, gamma, r_max=reward.max((-2, -1)), variant=variant
            )

    # Up to rounding, which a bound that is attained needs.
    holds = {name: gap <= limit * (1.0 + 1e-9) + 1e-10 for name, limit in limits.items()}
    return BoundCheck(gap=gap, bounds=limits, holds=holds)


def _corrected(p: Problem, k: int, gamma: float, nu: Mismatch) -> dict[str, Floats]:
    """Returns the bounds that hold, by name."""
    span = p.reward.max((-2, -1)) - p.reward.min((-2, -1))
    common = np.einsum("...sg,...gs->...s", p.high, agreement(p, k))
    # Of a single step: the greatest total variation of the actions in a state.
    slip = np.abs(p.flat[..., None, :, :] - p.low).sum(-1).max((-2, -1)) / 2.0

    def bound(total_variation: Floats, steps: int, form: bounds.Form = "sharp") -> Floats:
        return bounds.value_gap_bound(
            np.clip(total_variation, 0.0, 1.0), steps, gamma, reward_span=span, form=form
        )

    ends = np.minimum(nu.endpoint_total_variation, 1.0)
    return {
        "path": bound(nu.path_total_variation, k),
        "path, linear": bound(nu.path_total_variation, k, "linear"),
        "agreement": bound((1.0 - common).max(-1), k),
        "one step": bound(slip, 1),
        "endpoint": bounds.endpoint_value_gap_bound(
            ends, nu.reward_gap, k, gamma, reward_span=span
        ),
    }


def _path_distances(
    p: Problem, k: int, max_paths: int
) -> tuple[Float[np.ndarray, "... S"], Float[np.ndarray, "... S"]]:
    """Returns half the L1 norm and the maximum norm between path laws, by first state.

    A path's probability is what the MDP contributes times what the policies do, so both laws share
    the former. Axes: subgoal (the low level's), first state, path up to a state, next action.
    """
    *lead, num_states, num_actions = p.flat.shape
    num_subgoals = p.low.shape[-3]
    num_paths = (num_states * num_actions) ** k
    if num_paths > max_paths:
        raise ValueError(f"k = {k} makes {num_paths} paths, at most {max_paths} are enumerated")

    shared = np.ones((*lead, num_states, 1))
    by_flat = p.flat[..., None, :]
    by_low = (np.swapaxes(p.high, -2, -1)[..., None] * p.low)[..., None, :]
    onward = p.transition[..., None, :, :]  # from the last state of each path

    # Every pass makes the paths longer by an action and a state.
    for _ in range(k - 1):
        num = shared.shape[-1] * num_actions
        first, longer = (*lead, num_states), num * num_states
        shared = (shared[..., None, None] * onward).reshape(*first, longer)
        by_flat = by_flat.reshape(*first, num, 1, 1) * p.flat[..., None, None, :, :]
        by_flat = by_flat.reshape(*first, longer, num_actions)

        by_low = by_low.reshape(*lead, num_subgoals, num_states, num, 1, 1)
        by_low = (by_low * p.low[..., None, None, :, :]).reshape(
            *lead, num_subgoals, num_states, longer, num_actions
        )

        onward = p.transition[..., None, None, :, :, :]
        onward = np.broadcast_to(onward, (*first, num, *onward.shape[-3:]))
        onward = onward.reshape(*first, longer, num_actions, num_states)

    apart = np.abs(by_flat - by_low.sum(-4)) * shared[..., None]
    return apart.sum((-2, -1)) / 2.0, (apart * onward.max(-1)).max((-2, -1))
