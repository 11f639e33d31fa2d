"""Pictures drawn straight from a maze, without the task's prepared tables."""

from eihrl_jax.envs import raster
from eihrl_jax.mazes import maze as maze_lib


def patch(maze, xy, visited, silhouette, view):
    """Draws what the high level sees at `xy` of a maze with its door drawn; all around is wall."""
    i, j = raster.window(xy, view)
    codes = maze_lib.codes(maze).at[i, j]
    codes = codes.get(mode="fill", fill_value=maze_lib.WALL, wrap_negative_indices=False)
    return raster.draw(codes, xy, visited, raster.pack(silhouette, view), view)
