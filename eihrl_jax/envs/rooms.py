"""Rooms in which the low level learns: no goals, only floor and walls to run into."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int

from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import perfect

START_JITTER = 0.2
"""Half-width in units of a start's offset, if no other is asked for; what fits into a cell starts
clear of walls."""

SIZE = 15
"""Rows and columns of a room to learn in, its outer ring of wall included; an odd number."""


class Rooms(struct.PyTreeNode):
    """M rooms of one size.

    Attributes:
      mazes: the rooms as mazes with leading axis M; every start is a free cell.
      is_corridor: bool [M], which of them are corridors of one cell's width, where a robot follows
        only directions that are free and its subgoals are anchored, see `task.anchor`.
    """

    mazes: maze_lib.Maze
    is_corridor: Bool[Array, " M"]

    def one(self, index: Int[Array, ""]) -> maze_lib.Maze:
        """Returns one of the rooms."""
        return jax.tree.map(lambda leaf: leaf[index], self.mazes)


def open_floor(size: int = 41, start_jitter: float = START_JITTER) -> Rooms:
    """Returns one wide room, its start in the middle, far from any wall.

    Args:
      size: cells a side.
      start_jitter: see `random_rooms`.
    """
    start = np.zeros((size, size), bool)
    start[size // 2, size // 2] = True
    return _rooms(np.zeros((1, size, size), bool), start[None], start_jitter=start_jitter)


def random_rooms(
    num_rooms: int,
    seed: int,
    *,
    wall_density: float = 0.15,
    corridor_share: float = 0.0,
    start_jitter: float = START_JITTER,
) -> Rooms:
    """Draws square rooms; of those that are no corridors every second one is empty.

    Args:
      num_rooms: how many.
      seed: of the walls.
      wall_density: share of the inner cells that are wall in the rooms that aren't empty.
      corridor_share: share of the rooms that are corridors of one cell's width with turns, branches
        and dead ends; they come last.
      start_jitter: half-width of the uniform offset of a start from the middle of its cell, units.

    Returns:
      The rooms; every free cell is a start.
    """
    rng = np.random.default_rng(seed)
    wall = rng.random((num_rooms, SIZE, SIZE)) < wall_density
    wall[::2] = False

    # Closed all around, or the robot would leave the grid.
    wall[:, [0, -1], :] = True
    wall[:, :, [0, -1]] = True

    # Drawn after all the rest, which is the same whatever the share.
    num_corridors = round(corridor_share * num_rooms)
    for index in range(num_rooms - num_corridors, num_rooms):
        # Turned over, as they were drawn when the docs' figures were measured.
        wall[index] = ~perfect.ways(rng, SIZE - 2, SIZE - 2, (0, 0)).T
    return _rooms(wall, ~wall, num_corridors, start_jitter)


def _rooms(
    wall: np.ndarray,
    start: np.ndarray,
    num_corridors: int = 0,
    start_jitter: float = START_JITTER,
) -> Rooms:
    """Returns rooms [M, R, C], the last ones corridors, without goals, doors or a time limit."""
    num_rooms = len(wall)
    zero = jnp.zeros(num_rooms, jnp.int32)  # episodes here have limits of their own
    mazes = maze_lib.Maze(
        wall=jnp.asarray(wall),
        goal=jnp.zeros(wall.shape, jnp.int32),
        start=jnp.asarray(start),
        door=jnp.zeros(wall.shape, bool),
        start_jitter=jnp.full(num_rooms, start_jitter, jnp.float32),
        num_goals=zero,
        num_decisions=zero,
    )
    return Rooms(mazes, jnp.arange(num_rooms) >= num_rooms - num_corridors)
