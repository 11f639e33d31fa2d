"""Exact values of flat and hierarchical policies on finite MDPs, to check bounds against.

Arrays are NumPy's, in float64. All may have leading axes, the same for all: many MDPs at once. S:
states, A: actions, G: subgoals.

| name | shape | meaning |
|---|---|---|
| transition | [S, A, S] | probability of the next state |
| reward | [S, A] | expected reward of a step |
| flat | [S, A] | probability of an action under the flat policy |
| low | [G, S, A] | the same under the low level, given a subgoal |
| high | [S, G] | probability of a subgoal, drawn every k steps |

Functions raise ValueError where a shape doesn't fit or probabilities don't sum to 1.
"""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from eihrl_jax.theory import arguments
from eihrl_jax.theory.arguments import Count, Discount
from eihrl_jax.theory.segments import SegmentReward

Matrix = Float[np.ndarray, "... S S"]
Vector = Float[np.ndarray, "... S"]


@arguments.checked
def k_step_model(
    transition: ArrayLike,
    reward: ArrayLike,
    flat: ArrayLike,
    k: Count,
    gamma: Discount,
    *,
    segment_reward: SegmentReward = "discounted",
) -> tuple[Matrix, Vector]:
    """Computes where k steps of a policy lead, and what they pay.

    Args:
      transition: [..., S, A, S].
      reward: [..., S, A].
      flat: [..., S, A].
      k: at least 1.
      gamma: in [0, 1).
      segment_reward: whether rewards are discounted inside the k steps.

    Returns:
      float64 [..., S, S], probabilities of the state after k steps, and [..., S], expected rewards.

    Raises:
      ValueError: an argument has a wrong shape or value.
      TypeError: k isn't an integer.
    """
    transition, reward, flat = _check(transition, reward, flat)
    kernel, one_reward = _one_step(transition, reward, flat)
    return _repeat(kernel, one_reward, k, gamma, segment_reward)


@arguments.checked
def option_models(
    transition: ArrayLike,
    reward: ArrayLike,
    low: ArrayLike,
    k: Count,
    gamma: Discount,
    *,
    segment_reward: SegmentReward = "discounted",
) -> tuple[Float[np.ndarray, "... G S S"], Float[np.ndarray, "... G S"]]:
    """Computes `k_step_model` of the low level under each subgoal.

    Args:
      transition: [..., S, A, S].
      reward: [..., S, A].
      low: [..., G, S, A].
      k: at least 1.
      gamma: in [0, 1).
      segment_reward: whether rewards are discounted inside the k steps.

    Returns:
      float64 [..., G, S, S] and [..., G, S].

    Raises:
      ValueError: an argument has a wrong shape or value.
      TypeError: k isn't an integer.
    """
    transition = arguments.transition(transition)
    sizes = transition.shape[-3:-1]
    reward = arguments.table("reward", reward, sizes)
    low = arguments.probabilities("low", low, (None, *sizes))
    return k_step_model(
        transition[..., None, :, :, :],
        reward[..., None, :, :],
        low,
        k,
        gamma,
        segment_reward=segment_reward,
    )


@arguments.checked
def policy_value(
    transition: ArrayLike, reward: ArrayLike, flat: ArrayLike, gamma: Discount
) -> Vector:
    """Computes the values of a flat policy: float64 [..., S].

    Raises:
      ValueError: an argument has a wrong shape or value.
    """
    return segment_value(transition, reward, flat, 1, gamma)


@arguments.checked
def segment_value(
    transition: ArrayLike,
    reward: ArrayLike,
    flat: ArrayLike,
    k: Count,
    gamma: Discount,
    *,
    segment_reward: SegmentReward = "discounted",
) -> Vector:
    """Computes the values of a flat policy as a hierarchy's are counted: in segments of k steps.

    With discounted segments they are `policy_value`.

    Raises:
      ValueError: an argument has a wrong shape or value.
      TypeError: k isn't an integer.
    """
    kernel, rewards = k_step_model(
        transition, reward, flat, k, gamma, segment_reward=segment_reward
    )
    return _solve(kernel, rewards, gamma**k)


@arguments.checked
def hierarchical_value(
    transition: ArrayLike,
    reward: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    k: Count,
    gamma: Discount,
    *,
    segment_reward: SegmentReward = "discounted",
) -> Vector:
    """Computes the values of a hierarchy when a subgoal is about to be drawn: float64 [..., S].

    Args:
      transition: [..., S, A, S].
      reward: [..., S, A].
      low: [..., G, S, A].
      high: [..., S, G].
      k: at least 1.
      gamma: in [0, 1).
      segment_reward: whether rewards are discounted inside the k steps.

    Raises:
      ValueError: an argument has a wrong shape or value.
      TypeError: k isn't an integer.
    """
    kernels, rewards = option_models(
        transition, reward, low, k, gamma, segment_reward=segment_reward
    )
    num_subgoals, num_states = rewards.shape[-2:]
    chosen = arguments.probabilities("high", high, (num_states, num_subgoals))
    return _solve(*mix(kernels, rewards, chosen), gamma**k)


@arguments.checked
def optimal_value(
    transition: ArrayLike, reward: ArrayLike, gamma: Discount
) -> tuple[Vector, Float[np.ndarray, "... S A"]]:
    """Computes the best values of all policies, and a deterministic policy that attains them.

    Raises:
      ValueError: an argument has a wrong shape or value.
    """
    transition = arguments.transition(transition)
    reward = arguments.table("reward", reward, transition.shape[-3:-1])
    return _improve(np.swapaxes(transition, -3, -2), np.swapaxes(reward, -2, -1), gamma)


@arguments.checked
def optimal_hierarchical_value(
    transition: ArrayLike,
    reward: ArrayLike,
    low: ArrayLike,
    k: Count,
    gamma: Discount,
    *,
    segment_reward: SegmentReward = "discounted",
) -> tuple[Vector, Float[np.ndarray, "... S G"]]:
    """Computes the best values of all high levels, and a deterministic one that attains them.

    Raises:
      ValueError: an argument has a wrong shape or value.
      TypeError: k isn't an integer.
    """
    kernels, rewards = option_models(
        transition, reward, low, k, gamma, segment_reward=segment_reward
    )
    return _improve(kernels, rewards, gamma**k)


def _check(
    transition: ArrayLike, reward: ArrayLike, flat: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the three in float64 after checking that they fit together."""
    transition = arguments.transition(transition)
    sizes = transition.shape[-3:-1]
    reward = arguments.table("reward", reward, sizes)
    policy = arguments.probabilities("flat", flat, sizes)
    return transition, reward, policy


def _one_step(
    transition: np.ndarray, reward: np.ndarray, policy: np.ndarray
) -> tuple[Matrix, Vector]:
    return np.einsum("...sa,...sat->...st", policy, transition), (policy * reward).sum(-1)


def _repeat(
    kernel: Matrix, one_reward: Vector, k: int, gamma: float, segment_reward: SegmentReward
) -> tuple[Matrix, Vector]:
    """Returns the kernel's k-th power, and the rewards of k steps."""
    discount = gamma if segment_reward == "discounted" else 1.0
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
