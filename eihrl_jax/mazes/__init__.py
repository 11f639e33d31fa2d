"""Mazes as text, as pytrees, and as random rooms."""

from eihrl_jax.mazes import layouts, maze, suites
from eihrl_jax.mazes.files import NAMES, load, load_all
from eihrl_jax.mazes.maze import Maze, stack
from eihrl_jax.mazes.parsing import parse

__all__ = ["NAMES", "Maze", "layouts", "load", "load_all", "maze", "parse", "stack", "suites"]
