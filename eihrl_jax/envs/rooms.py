"""Rooms in which the low level learns: no goals, only floor and walls to run into."""

import jax.numpy as jnp
import numpy as np

from eihrl_jax.mazes import maze as maze_lib

START_JITTER = 0.2
"""Half-width in units of the start's offset; what fits into a cell starts clear of walls."""


def open_floor(size: int = 41) -> maze_lib.Maze:
    """Returns one wide room with leading axis 1, its start in the middle, far from any wall."""
    start = np.zeros((size, size), bool)
    start[size // 2, size // 2] = True
    return _stack(np.zeros((1, size, size), bool), start[None])


def random_rooms(
    num_rooms: int, seed: int, *, size: int = 15, wall_density: float = 0.15
) -> maze_lib.Maze:
    """Draws square rooms with leading axis `num_rooms`; every second one is empty.

    Args:
      num_rooms: how many.
      seed: of the walls.
      size: rows and columns of each, its outer ring of wall included.
      wall_density: share of the inner cells that are wall in the rooms that aren't empty.

    Returns:
      The rooms; every free cell is a start.
    """
    wall = np.random.default_rng(seed).random((num_rooms, size, size)) < wall_density
    wall[::2] = False

    # Closed all around, or the robot would leave the grid.
    wall[:, [0, -1], :] = True
    wall[:, :, [0, -1]] = True
    return _stack(wall, ~wall)


def _stack(wall: np.ndarray, start: np.ndarray) -> maze_lib.Maze:
    """Returns rooms [M, R, C] as mazes without goals, doors or a time limit."""
    zero = jnp.zeros(wall.shape[0], jnp.int32)  # episodes here have limits of their own
    return maze_lib.Maze(
        wall=jnp.asarray(wall),
        goal=jnp.zeros(wall.shape, jnp.int32),
        start=jnp.asarray(start),
        door=jnp.zeros(wall.shape, bool),
        start_jitter=jnp.full(wall.shape[0], START_JITTER, jnp.float32),
        num_goals=zero,
        num_decisions=zero,
    )
