"""Files that the options of a training name, which its run folder keeps, see `runs.sources`."""

import pathlib

import jax

from eihrl_jax import mazes, robots
from eihrl_jax.envs import subgoals
from eihrl_jax.mazes import parsing
from eihrl_jax.robots import mjcf
from eihrl_jax.runs import sources
from eihrl_jax.storage import reading


def of_maze(maze: mazes.Maze) -> sources.Files:
    """Returns a maze, which may have a leading axis of 1, as one of our files."""
    if maze.wall.ndim == 3:
        maze = jax.tree.map(lambda leaf: leaf[0], maze)
    return {"maze.txt": parsing.text_of(maze).encode()}


def of_robot(name: str) -> sources.Files:
    """Returns the description and the model of a user's robot; nothing for a shipped one."""
    if name in robots.NAMES:
        return {}
    path = robots.load(name).mjcf
    named = {file.relative_to(path.parent).as_posix(): file for file in mjcf.files(path)}
    named["robot.toml"] = pathlib.Path(name)
    return {
        key: reading.read_bytes(file, limit=mjcf.MAX_ASSET_BYTES) for key, file in named.items()
    }


def of_measurement(folder: pathlib.Path | None) -> sources.Files:
    """Returns the figures and the postures of a measurement, if there is one."""
    if folder is None:
        return {}
    names = (subgoals.FILE, subgoals.POSTURES)
    return {name: reading.read_bytes(folder / name) for name in names}
