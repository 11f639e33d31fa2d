"""HESS's active exploration: subgoals that are new, and that can be reached (Li et al. 2021).

The subgoal space is hashed into squares. The novelty of a square counts the visits to it and to
what came after it (Sec. 3.2); its potential tells how badly the controller got there (Sec. 3.3).
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax.config import hess as config_lib

NUM_SQUARES = 128
"""Squares along each axis; what lies beyond counts for the outermost ones."""


class ExplorationState(struct.PyTreeNode):
    """What is known about the squares of the subgoal space.

    Attributes:
      visits: float32 [S, S], states that lay in each; S: `NUM_SQUARES`.
      novelty: float32 [S, S], mean discounted visits from there on; small where it is new.
      misses: float32 [S, S], sum of the distances by which subgoals there were missed.
    """

    visits: Float[Array, "S S"]
    novelty: Float[Array, "S S"]
    misses: Float[Array, "S S"]


def init() -> ExplorationState:
    """Returns the state before anything was visited."""
    # Where nothing has been counted novelty is (0 + 1) / (0 + 1), see `look_ahead`.
    zeros = jnp.zeros((NUM_SQUARES, NUM_SQUARES))
    return ExplorationState(visits=zeros, novelty=jnp.ones_like(zeros), misses=zeros)


def add(
    numbers: Float[Array, "S S"],
    embedding: Float[Array, "*B 2"],
    amount: Float[Array, "*B"],
    side: float,
) -> Float[Array, "S S"]:
    """Adds amounts to the squares in which embeddings lie; `side` is that of a square."""
    return numbers.at[square(embedding, side)].add(amount)


def look_ahead(
    state: ExplorationState,
    embedding: Float[Array, "E J 2"],
    is_valid: Bool[Array, "E J"],
    options: config_lib.Exploration,
) -> ExplorationState:
    """Computes every square's novelty count from all stored episodes; a low count means novel.

    N_j = n(square of s_j) + gamma N_{j+1} along the ends of an episode's periods; a square's
    novelty is (sum of N + 1) / (number + 1) over those that lie in it.

    Args:
      state: the counts so far.
      embedding: where periods ended, in the order of time.
      is_valid: whether there was such a period.
      options: discount and side of a square.
    """
    counts = jnp.where(is_valid, state.visits[square(embedding, options.square)], 0.0)

    def back(ahead: Float[Array, " E"], count: Float[Array, " E"]) -> tuple[Array, Array]:
        total = count + options.gamma * ahead
        return total, total

    # Li et al. 2021, Sec. 3.2: backwards in time, as N_j needs N_{j+1}.
    _, totals = jax.lax.scan(back, jnp.zeros(embedding.shape[0]), counts.T, reverse=True)

    # The mean over all visits, as in the paper; in the released code only the last stored visit is
    # added, and divided by the number of all.
    weight, zeros = is_valid.astype(jnp.float32), jnp.zeros_like(state.visits)
    sums = add(zeros, embedding, weight * totals.T, options.square)
    numbers = add(zeros, embedding, weight, options.square)
    return state.replace(novelty=(sums + 1.0) / (numbers + 1.0))


def select(
    state: ExplorationState,
    here: Float[Array, "2"],
    candidates: Float[Array, "C 2"],
    has_potential: Bool[Array, ""],
    options: config_lib.Exploration,
    key: Key[Array, ""],
) -> Float[Array, "2"]:
    """Picks the most promising of some visited states within reach.

    Args:
      state: what is known about the squares.
      here: the robot's embedding.
      candidates: embeddings of visited states.
      has_potential: whether squares whose subgoals were missed are avoided already.
      options: reach and weights.
      key: consumed, to choose where nothing is within reach.

    Returns:
      The candidate with the smallest novelty count plus weighted misses; a random one, if none is
      within reach.
    """
    # A candidate at the robot's own place would be no subgoal.
    distance = jnp.sqrt(jnp.square(candidates - here[None]).sum(-1))
    is_near = (distance > 0.0) & (distance < options.reach)

    # Li et al. 2021, Sec. 3.3: squares whose subgoals were missed have little potential.
    index = square(candidates, options.square)
    weight = jnp.where(has_potential, options.miss_weight, 0.0)
    cost = state.novelty[index] + weight * state.misses[index]

    any_of_them = jax.random.randint(key, (), 0, candidates.shape[0])
    best = jnp.argmin(jnp.where(is_near, cost, jnp.inf))
    return candidates[jnp.where(is_near.any(), best, any_of_them)]


def square(
    embedding: Float[Array, "*B 2"], side: float
) -> tuple[Int[Array, "*B"], Int[Array, "*B"]]:
    """Returns the indices of the squares that embeddings lie in."""
    # Indices begin at the middle; they are clipped, as negative ones would count from the end.
    index = jnp.floor(embedding / side).astype(jnp.int32) + NUM_SQUARES // 2
    index = jnp.clip(index, 0, NUM_SQUARES - 1)
    return index[..., 0], index[..., 1]
