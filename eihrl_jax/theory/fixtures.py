"""Small MDPs with known answers, and random ones: what the bounds are tried on."""

import numpy as np
from numpy.typing import ArrayLike

from eihrl_jax.theory import arguments
from eihrl_jax.theory.arguments import Count, Share
from eihrl_jax.theory.problem import Problem


@arguments.checked
def keep_or_fall(delta: Share, *, per_step: bool = False) -> Problem:
    """Returns the chain in which Theorem 1 is an equality (docs/theory.md, CE1 and CE4).

    State 0 pays 1 for keeping (action 0), and nothing for falling (action 1) to state 1, where
    nothing is paid for ever. The flat policy keeps. The hierarchy falls with probability `delta`.

    Args:
      delta: in [0, 1].
      per_step: the low level falls in any step, under the only subgoal; else the high level chooses
        between keeping and falling at the start of a segment.

    Raises:
      ValueError: `delta` is outside.
    """
    keep, fall = [1.0, 0.0], [0.0, 1.0]
    if per_step:
        low, high = [[[1.0 - delta, delta]] * 2], [[1.0]] * 2
    else:
        low, high = [[keep] * 2, [fall] * 2], [[1.0 - delta, delta]] * 2
    return _problem([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [keep, [0, 0]], [keep] * 2, low, high)


@arguments.checked
def disjoint_uniform(num: Count) -> Problem:
    """Returns an MDP in which every maximum norm is 1 / num and yet all is lost (CE2).

    From state 0, action 0 leads to any of `num` states that pay 1 for ever, action 1 to any of
    `num` others that pay nothing. The flat policy takes action 0, the hierarchy action 1; from then
    on they do the same.

    Raises:
      TypeError, ValueError: `num` is no integer, or below 1.
    """
    transition = np.zeros((1 + 2 * num, 2, 1 + 2 * num))
    transition[0, 0, 1 : 1 + num] = transition[0, 1, 1 + num :] = 1.0 / num
    ends = np.arange(1, 1 + 2 * num)
    transition[ends, :, ends] = 1.0

    reward = np.zeros((1 + 2 * num, 2))
    reward[1 : 1 + num] = 1.0
    return _opposite(transition, reward)


def equal_endpoints() -> Problem:
    """Returns an MDP in which every distance between end points is 0 and yet all is lost (CE3).

    One state, in which action 0 pays 1 and action 1 nothing; the hierarchy takes action 1.
    """
    return _opposite(np.ones((1, 2, 1)), np.array([[1.0, 0.0]]))


def equal_distances() -> Problem:
    """Returns an MDP in which goals at equal distances pay differently (CE5).

    From state 0, action 0 leads to state 1, which pays 1 for ever, action 1 to state 2, which pays
    nothing. The flat policy takes action 0, the hierarchy action 1.
    """
    transition = np.zeros((3, 2, 3))
    transition[0, 0, 1] = transition[0, 1, 2] = 1.0
    transition[1, :, 1] = transition[2, :, 2] = 1.0
    return _opposite(transition, np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]))


@arguments.checked
def random_mdps(
    seed: int,
    num: Count,
    *,
    num_states: Count = 4,
    num_actions: Count = 2,
    num_subgoals: Count = 2,
    closeness: Share = 0.5,
) -> Problem:
    """Draws MDPs with policies, some of them sparse or deterministic.

    Args:
      seed: of the draw.
      num: number N of MDPs, the leading axis.
      num_states: S.
      num_actions: A.
      num_subgoals: G.
      closeness: share of the MDPs in which the low level is a perturbed flat policy, not any.

    Raises:
      TypeError, ValueError: a number is no integer, or out of its range.
    """
    n, s, a, g = num, num_states, num_actions, num_subgoals
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        """Rows from a Dirichlet law; small concentrations make them nearly deterministic."""
        concentration = rng.choice([0.1, 0.5, 1.0, 5.0], size=(n,) + (1,) * len(shape))
        rows = rng.gamma(concentration, size=(n, *shape)) + 1e-12
        return rows / rows.sum(-1, keepdims=True)

    # Half of the flat policies are deterministic: there `mismatch.agreement` is exact.
    flat, low, high = draw(s, a), draw(g, s, a), draw(s, g)
    is_deterministic = rng.random((n, 1, 1)) < 0.5
    flat = np.where(is_deterministic, np.eye(a)[flat.argmax(-1)], flat)

    # Bounds say something only where the two come near each other.
    weight = rng.uniform(0.0, 0.3, (n, 1, 1, 1))
    is_close = rng.random((n, 1, 1, 1)) < closeness
    low = np.where(is_close, (1.0 - weight) * flat[:, None] + weight * low, low)

    # Sparse in some: there a wrong path costs most.
    reward = rng.random((n, s, a)) * (rng.random((n, s, a)) < rng.uniform(0.2, 1.0, (n, 1, 1)))
    return Problem(transition=draw(s, a, s), reward=reward, flat=flat, low=low, high=high)


def _opposite(transition: np.ndarray, reward: np.ndarray) -> Problem:
    """Returns a problem with a flat policy of action 0, from which one subgoal parts in state 0."""
    keep = [[1, 0]] * reward.shape[0]
    return _problem(transition, reward, keep, [[[0, 1], *keep[1:]]], [[1]] * len(keep))


def _problem(*tables: ArrayLike) -> Problem:
    return Problem(*(np.asarray(table, np.float64) for table in tables))
