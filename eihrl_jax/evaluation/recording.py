"""Recordings of episodes, from which animations are drawn."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from eihrl_jax.envs import hierarchy
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


class Decision(struct.PyTreeNode):
    """What episodes did in one decision.

    Attributes:
      seen: uint8 [..., B], what the high level saw, eight pixels a byte; None for a baseline.
      action: int32 [...].
      trace: the way.
    """

    seen: UInt8[Array, "*n B"] | None
    action: Int[Array, "*n"]
    trace: hierarchy.Trace

    @classmethod
    def of(
        cls, obs: Bool[Array, "n m C"] | None, action: Int[Array, ""], trace: hierarchy.Trace
    ) -> "Decision":
        """Returns the decision of one episode, which saw `obs` before it."""
        return cls(None if obs is None else jnp.packbits(obs), action, trace)


def of_episode(
    maze: maze_lib.Maze, decisions: Decision, obs: jax.ShapeDtypeStruct | None
) -> Recording:
    """Makes the recording of one episode, in a maze whose door is open.

    Args:
      maze: the maze.
      decisions: of the episode.
      obs: shape of what the high level sees.
    """
    # Flattened to moves: [D, k] with a mask, of which the moves after the episode's end fall out.
    trace, is_running = decisions.trace, np.asarray(decisions.trace.is_running)
    patch = None
    if decisions.seen is not None and obs is not None:
        patch = _cropped(_unpacked(np.asarray(decisions.seen), obs.shape))
    return Recording(
        maze=maze,
        qpos=np.asarray(trace.qpos)[is_running],
        decision=np.nonzero(is_running)[0],
        direction=None if patch is None else np.asarray(decisions.action),
        patch=patch,
        is_fallen=np.asarray(trace.is_fallen)[is_running],
    )


def _unpacked(
    seen: UInt8[np.ndarray, "D B"], shape: tuple[int, ...]
) -> Bool[np.ndarray, "D n m C"]:
    """Returns the pixels of what was seen."""
    bits = np.unpackbits(seen, axis=-1, count=math.prod(shape))
    return bits.reshape(-1, *shape).astype(bool)


def _cropped(patch: Bool[np.ndarray, "D n m C"]) -> Bool[np.ndarray, "D k k C"]:
    """Cuts off the rows and columns of a map in which nothing is ever seen; it stays a square."""
    _, rows, columns, channels = patch.shape
    if channels < 4 or not len(patch):  # a view, of which all is seen
        return patch

    is_seen = ~patch[-1, ..., 3]
    i, j = np.flatnonzero(is_seen.any(1)), np.flatnonzero(is_seen.any(0))
    side = max(i[-1] - i[0], j[-1] - j[0]) + 1
    first = min(i[0], max(0, rows - side)), min(j[0], max(0, columns - side))
    square = np.zeros((len(patch), side, side, channels), bool)
    square[..., 3] = True
    part = patch[:, first[0] : first[0] + side, first[1] : first[1] + side]
    square[:, : part.shape[1], : part.shape[2]] = part
    return square
