"""Mazes as text, as pytrees, from the files of other projects, and as random rooms."""

from eihrl_jax.mazes import layouts, maze, suites
from eihrl_jax.mazes.files import NAMES, load, load_all, save
from eihrl_jax.mazes.maze import Maze, stack
from eihrl_jax.mazes.parsing import parse

__all__ = [
    "NAMES",
    "Maze",
    "layouts",
    "load",
    "load_all",
    "maze",
    "parse",
    "save",
    "stack",
    "suites",
]
