"""Grids of Gymnasium-Robotics, D4RL, OGBench and JaxGCRL: `maze_map` lists, and D4RL's strings.

A `maze_map` is a list of rows, in JSON or as a `.npy` array: 1 wall, 0 free, `r` start, `g` goal,
of which one is drawn per episode, `c` both. Without any `r` and `c` every 0 is a start, without any
`g` and `c` every 0 may be the goal. JaxGCRL's lists lie transposed. A string of D4RL's maze2d has
`#` wall, `O` free, `G` goal, and a backslash between rows; its starts are anywhere.

Sources: Gymnasium-Robotics' `maze_v4.py`; D4RL's `pointmaze/maze_model.py`; JaxGCRL's
`ant_maze.py`.
"""

import io
import json
import math
import tokenize
import warnings
from typing import Any

import numpy as np

from eihrl_jax import base
from eihrl_jax.config import reading
from eihrl_jax.mazes import parsing, paths
from eihrl_jax.mazes.readers import levels
from eihrl_jax.mazes.readers import plan as plan_lib

_NAMES = {"1": "#", "0": ".", "r": "S", "g": "G", "c": "*"}
"""What stands in a list, and what it is in our legend."""

_HEADER_ERRORS = (EOFError, KeyError, SyntaxError, TypeError, ValueError, tokenize.TokenError)
"""What NumPy raises for a damaged header."""

_MAX_HEADER = 1_000
"""Largest size of an array's header, bytes."""


def of_json(text: str, options: reading.ReadingConfig, name: str) -> plan_lib.Plan:
    """Reads a list of rows, or an object of minimax, in JSON; `name` is the maze's in messages.

    Raises:
      base.UserError: it isn't such a maze; the text names the row and column, or the entry.
    """
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise base.UserError(
            f"{name}: no JSON: {error.msg} at line {error.lineno}, column {error.colno}"
        ) from None
    except (RecursionError, ValueError):  # a number of thousands of digits
        raise base.UserError(f"{name}: no JSON of a maze: too deep, or too long a number") from None

    if isinstance(content, dict):
        return levels.minimax_json(content, name)
    if isinstance(content, list) and content and isinstance(content[0], str):
        return levels.minimax_json({"wall_map": content}, name)
    return _of_rows(content, options, name)


def of_npy(data: bytes, options: reading.ReadingConfig, name: str) -> plan_lib.Plan:
    """Reads a NumPy array of numbers or characters; arrays of objects would run code.

    Raises:
      base.UserError: it isn't such a maze; the text names the row and column, or the entry.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about arrays written by Python 2, which are read as well
        return _of_npy(data, options, name)


def _of_npy(data: bytes, options: reading.ReadingConfig, name: str) -> plan_lib.Plan:
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = read_header(stream, max_header_size=_MAX_HEADER)
        # Checked before anything is allocated, because a header may claim any size.
        is_whole = math.prod(shape) * dtype.itemsize == len(data) - stream.tell()
    except (*_HEADER_ERRORS, RecursionError):
        raise base.UserError(f"{name}: a damaged .npy file") from None

    if dtype.hasobject or dtype.kind not in "biufSU":
        raise base.UserError(f"{name}: an array of {dtype}, must be of numbers or characters")
    if len(shape) != 2 or not is_whole:
        raise base.UserError(f"{name}: an array of shape {shape}, must be whole and have 2 axes")
    cells = np.load(io.BytesIO(data), allow_pickle=False)
    if cells.dtype.kind == "S":
        cells = np.char.decode(cells, "latin-1")
    return _of_rows(cells.tolist(), options, name)


def of_d4rl(text: str, name: str) -> plan_lib.Plan:
    """Reads a string of D4RL's maze2d.

    Raises:
      base.UserError: it isn't such a string; the text names the row and column, or the entry.
    """
    rows = [row.strip("\n\t\"' ") for row in text.strip().strip("\\").split("\\")]
    for i, row in enumerate(rows):
        for j, character in enumerate(row):
            if character not in "#O0G":
                raise base.UserError(
                    f"{name}: unknown character {character!r} at row {i + 1}, column {j + 1}; "
                    "known are # O 0 and G"
                )
        parsing.check_length(len(row), i, len(rows[0]), name)

    grid = np.array([list(row) for row in rows])
    goals = paths.cells(grid == "G")
    if len(goals) > 1:
        raise base.UserError(f"{name}: {len(goals)} goals G, a string of D4RL has at most 1")
    free = grid != "#"
    # As in D4RL: without a goal it is the first free cell.
    goals = goals or paths.cells(free)[:1]
    starts = [cell for cell in paths.cells(free) if cell not in goals]
    return plan_lib.of_free("D4RL string", free, starts=starts, goals=goals, name=name)


def _of_rows(rows: Any, options: reading.ReadingConfig, name: str) -> plan_lib.Plan:
    """Reads a list of rows of cells."""
    if not (isinstance(rows, list) and rows and all(isinstance(row, list) for row in rows)):
        raise base.UserError(f"{name}: a maze_map is a list of lists of cells")
    if max(len(rows), *map(len, rows)) > parsing.MAX_SIZE or not rows[0]:
        raise base.UserError(
            f"{name}: {len(rows)} rows of {len(rows[0])} cells, must be at least 1 and at most "
            f"{parsing.MAX_SIZE}"
        )
    for i, row in enumerate(rows):
        parsing.check_length(len(row), i, len(rows[0]), name)

    grid = np.array(
        [[_mark(c, i, j, name) for j, c in enumerate(row)] for i, row in enumerate(rows)]
    )
    free = grid != "#"
    # Without any marked start (or goal) every free cell is one.
    is_start, is_goal = np.isin(grid, ["S", "*"]), np.isin(grid, ["G", "*"])
    is_start = is_start if is_start.any() else grid == "."
    is_goal = is_goal if is_goal.any() else grid == "."
    if options.transposed:
        free, is_start, is_goal = free.T, is_start.T, is_goal.T
    return plan_lib.of_free(
        "maze_map", free, starts=paths.cells(is_start), goals=paths.cells(is_goal), name=name
    )


def _mark(cell: object, i: int, j: int, name: str) -> str:
    """Returns a cell in our legend."""
    # Arrays of both numbers and letters hold their numbers as text.
    word = str(int(cell)) if isinstance(cell, int | float) and cell in (0, 1) else cell
    if not isinstance(word, str) or word not in _NAMES:
        raise base.UserError(
            f"{name}: unknown cell {str(cell)[:20]!r} at row {i + 1}, column {j + 1}; known are "
            "1, 0, 'r', 'g' and 'c'"
        )
    return _NAMES[word]
