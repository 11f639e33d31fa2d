"""Exact values of flat and hierarchical policies on finite MDPs, to check bounds against.

A `Problem` may have leading axes, for many MDPs at once; values have the same. S: states, A:
actions, G: subgoals. Functions raise ValueError where shapes don't fit or probabilities don't sum
to 1, and TypeError where k is no integer.
"""

import numpy as np
from jaxtyping import Float

from eihrl_jax.theory import arguments
from eihrl_jax.theory.arguments import Count, Discount
from eihrl_jax.theory.problem import Problem
from eihrl_jax.theory.segments import SegmentReward

Matrix = Float[np.ndarray, "... S S"]
Vector = Float[np.ndarray, "... S"]


@arguments.checked
def k_step_model(
    problem: Problem, k: Count, gamma: Discount, *, segment_reward: SegmentReward = "discounted"
) -> tuple[Matrix, Vector]:
    """Computes where k steps of the flat policy lead, and what they pay.

    Args:
      problem: whose hierarchy doesn't matter.
      k: at least 1.
      gamma: in [0, 1).
      segment_reward: whether rewards are discounted inside the k steps.

    Returns:
      float64 [..., S, S], probabilities of the state after k steps, and [..., S], expected rewards.
    """
    p = problem.checked()
    return _model(p.transition, p.reward, p.flat, k, gamma, segment_reward)


@arguments.checked
def option_models(
    problem: Problem, k: Count, gamma: Discount, *, segment_reward: SegmentReward = "discounted"
) -> tuple[Float[np.ndarray, "... G S S"], Float[np.ndarray, "... G S"]]:
    """Computes `k_step_model` of the low level under each subgoal, [..., G, S, S] and [..., G, S].

    Args:
      problem: whose high level and flat policy don't matter.
      k: at least 1.
      gamma: in [0, 1).
      segment_reward: whether rewards are discounted inside the k steps.
    """
    p = problem.checked()
    # With an axis for the subgoals, each of which is a policy of its own.
    transition, reward = p.transition[..., None, :, :, :], p.reward[..., None, :, :]
    return _model(transition, reward, p.low, k, gamma, segment_reward)


def policy_value(problem: Problem, gamma: Discount) -> Vector:
    """Computes the values of the flat policy: float64 [..., S]."""
    return segment_value(problem, 1, gamma)


@arguments.checked
def segment_value(
    problem: Problem, k: Count, gamma: Discount, *, segment_reward: SegmentReward = "discounted"
) -> Vector:
    """Computes the values of the flat policy as a hierarchy's are counted: in segments of k steps.

    With discounted segments they are `policy_value`.
    """
    kernel, rewards = k_step_model(problem, k, gamma, segment_reward=segment_reward)
    return _solve(kernel, rewards, gamma**k)


@arguments.checked
def hierarchical_value(
    problem: Problem, k: Count, gamma: Discount, *, segment_reward: SegmentReward = "discounted"
) -> Vector:
    """Computes the values of the hierarchy when a subgoal is about to be drawn: float64 [..., S].

    Args:
      problem: whose flat policy doesn't matter.
      k: at least 1, steps per subgoal.
      gamma: in [0, 1), discount per step.
      segment_reward: whether rewards are discounted inside the k steps.
    """
    models = option_models(problem, k, gamma, segment_reward=segment_reward)
    return _solve(*mix(*models, problem.checked().high), gamma**k)


@arguments.checked
def optimal_value(problem: Problem, gamma: Discount) -> tuple[Vector, Float[np.ndarray, "... S A"]]:
    """Computes the best values of all policies, and a deterministic policy that attains them."""
    p = problem.checked()
    # A choice is an action here, and a subgoal in `optimal_hierarchical_value`.
    return _improve(np.swapaxes(p.transition, -3, -2), np.swapaxes(p.reward, -2, -1), gamma)


@arguments.checked
def optimal_hierarchical_value(
    problem: Problem, k: Count, gamma: Discount, *, segment_reward: SegmentReward = "discounted"
) -> tuple[Vector, Float[np.ndarray, "... S G"]]:
    """Computes the best values of all high levels, and a deterministic one that attains them."""
    models = option_models(problem, k, gamma, segment_reward=segment_reward)
    return _improve(*models, gamma**k)


def _model(
    transition: np.ndarray,
    reward: np.ndarray,
    policy: np.ndarray,
    k: int,
    gamma: float,
    segment_reward: SegmentReward,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the kernel and the rewards of k steps of a policy."""
    kernel = np.einsum("...sa,...sat->...st", policy, transition)
    one_reward = (policy * reward).sum(-1)

    # Paper: eq. 3 discounts rewards inside a segment, Sec. 2 doesn't.
    discount = gamma if segment_reward == "discounted" else 1.0
    # Backwards: the reward of k steps is one step's and that of k - 1 from where it leads.
    power, rewards = kernel, one_reward
    for _ in range(k - 1):
        power = kernel @ power
        rewards = one_reward + discount * (kernel @ rewards[..., None])[..., 0]
    return power, rewards


def mix(
    kernels: Float[np.ndarray, "... G S S"],
    rewards: Float[np.ndarray, "... G S"],
    chosen: Float[np.ndarray, "... S G"],
) -> tuple[Matrix, Vector]:
    """Returns the model of a segment whose option is drawn in each state.

    Args:
      kernels: of the state after a segment, by option.
      rewards: expected in a segment, by option.
      chosen: probability of each option in each state.

    Returns:
      Kernel [..., S, S] and rewards [..., S].
    """
    kernel = np.einsum("...sg,...gst->...st", chosen, kernels)
    return kernel, np.einsum("...sg,...gs->...s", chosen, rewards)


def _solve(kernel: Matrix, rewards: Vector, discount: float) -> Vector:
    """Solves v = rewards + discount * kernel v."""
    system = np.eye(kernel.shape[-1]) - discount * kernel
    return np.linalg.solve(system, rewards[..., None])[..., 0]


def _improve(
    kernels: Float[np.ndarray, "... C S S"], rewards: Float[np.ndarray, "... C S"], discount: float
) -> tuple[Vector, Float[np.ndarray, "... S C"]]:
    """Returns what policy iteration over C choices ends with, in all MDPs at once."""
    num_choices = rewards.shape[-2]

    # All MDPs go on until the last of them has settled.
    best = np.zeros(rewards.shape[:-2] + rewards.shape[-1:], np.int64)
    while True:
        chosen = np.eye(num_choices)[best]
        value = _solve(*mix(kernels, rewards, chosen), discount)
        gains = rewards + discount * (kernels @ value[..., None, :, None])[..., 0]
        now = np.take_along_axis(gains, best[..., None, :], -2)[..., 0, :]

        # Only what gains more than rounding is changed, else equal choices would never settle.
        margin = 1e-12 * np.maximum(1.0, np.abs(now))
        is_better = gains.max(-2) > now + margin
        if not is_better.any():
            return value, chosen
        best = np.where(is_better, gains.argmax(-2), best)
