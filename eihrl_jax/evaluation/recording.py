"""One episode, recorded step by step: what an animation is drawn of."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from eihrl_jax.mazes import maze as maze_lib


@dataclasses.dataclass(frozen=True)
class Recording:
    """One episode, recorded to be drawn. T positions, D decisions.

    Attributes:
      maze: the maze with its door drawn.
      qpos: float [T, nq], the robot after each of its moves.
      decision: int [T], index of the decision during which each move was made.
      direction: int [D], subgoal of each decision; None for a baseline.
      patch: bool [D, P, P, C], what the high level saw; None for a baseline.
      is_fallen: bool [T].
    """

    maze: maze_lib.Maze
    qpos: Float[np.ndarray, "T nq"]
    decision: Int[np.ndarray, " T"]
    direction: Int[np.ndarray, " D"] | None
    patch: Bool[np.ndarray, "D P P C"] | None
    is_fallen: Bool[np.ndarray, " T"]
