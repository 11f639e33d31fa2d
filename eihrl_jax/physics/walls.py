"""Which wall cells a robot can touch: the physics model's few boxes are moved there every step."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eihrl_jax import base
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import kinematics, scene

_RING = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


_AROUND = [(i, j) for i in range(-2, 3) for j in range(-2, 3)]

_NUM_POINTS = 9
"""Points of a capsule's axis at which its depth is asked for."""


def nearby(
    maze: maze_lib.Maze, xy: Float[Array, "2"], num_walls: int
) -> Float[Array, "num_walls 2"]:
    """Returns the centres of the walls near a robot, in units, parked where there is none.

    A robot whose reach is below half a cell can only touch the other three cells of the 2x2 block
    around the corner of its own cell that is nearest to it; one with longer reach gets the eight
    cells around its own.

    Args:
      maze: the maze, its door drawn.
      xy: the torso's position, units.
      num_walls: 3 or 8, see `Robot.num_walls`.
    """
    own_ij = maze_lib.cell_ij(xy)

    if num_walls == 3:
        # Which corner of its own cell is nearest. Rows grow downwards, so y+ is row -1.
        x_sign, y_sign = jnp.where(xy >= maze_lib.cell_xy(own_ij), 1, -1)
        zero = jnp.zeros_like(x_sign)
        offset_ij = jnp.stack(
            [jnp.stack(pair) for pair in ((zero, x_sign), (-y_sign, zero), (-y_sign, x_sign))]
        )
    else:
        offset_ij = jnp.array(_RING)

    cell_xy = jax.vmap(maze_lib.cell_xy)(own_ij[None] + offset_ij)
    is_wall = jax.vmap(maze_lib.is_wall, in_axes=(None, 0))(maze, cell_xy)
    return jnp.where(is_wall[:, None], cell_xy, jnp.array([scene.PARKED_XY]))


def depth(
    maze: maze_lib.Maze, xy: Float[Array, "2"], capsules: kinematics.Capsules
) -> Float[Array, ""]:
    """Returns how deep the deepest part of a robot is in a wall, units; negative outside of all.

    Args:
      maze: the maze, its door drawn.
      xy: the torso's position, units; walls farther than two cells from its own don't count.
      capsules: the robot's parts, see `kinematics.capsules`.
    """
    start, end, radius = capsules
    share = jnp.linspace(0.0, 1.0, _NUM_POINTS)[:, None, None]
    points = (1.0 - share) * start[None, :, :2] + share * end[None, :, :2]

    cell_xy = jax.vmap(maze_lib.cell_xy)(maze_lib.cell_ij(xy)[None] + jnp.array(_AROUND))
    is_wall = jax.vmap(maze_lib.is_wall, in_axes=(None, 0))(maze, cell_xy)
    beyond = jnp.maximum(jnp.abs(points[:, :, None] - cell_xy[None, None]) - base.CELL / 2, 0.0)
    distance = jnp.where(is_wall, jnp.sqrt(jnp.square(beyond).sum(-1)), jnp.inf)
    return (radius[None] - distance.min(-1)).max()
