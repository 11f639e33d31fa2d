"""Levels of JaxUED and minimax: inner cells alone, one agent, one goal, a limit of their own.

JaxUED: rows of `#` wall, `.` free, `G` goal and the agent as an arrow, `>` `v` `<` `^`. minimax:
rows of `0` and `1` with blanks between them, as in its source or in JSON, with `goal_pos` (several:
one is drawn) and `agent_pos` as x and y. Which way the agent looks plays no part here.

Sources: JaxUED's `level.py`; minimax's `maze_ood.py`.
"""

import re
from typing import Any

import numpy as np

from eihrl_jax import base
from eihrl_jax.mazes import parsing, paths
from eihrl_jax.mazes.readers import plan as plan_lib

ARROWS = "><^v"

_ROW = re.compile(r"""[\s\["']*([01](?:[ \t]+[01])*)[\]"',\s]*""")
_POSITION = re.compile(r"\(\s*(\d{1,9})\s*,\s*(\d{1,9})\s*\)|\[\s*(\d{1,9})\s*,\s*(\d{1,9})\s*\]")


def is_jaxued(text: str) -> bool:
    """Returns whether a text is a JaxUED level: arrows are in no other kind."""
    return bool(set(ARROWS) & set(text)) and set(text) <= set("#.G \t\n" + ARROWS)


def is_minimax(text: str) -> bool:
    """Returns whether a text begins with a row of zeros and ones, or has one of minimax's names."""
    lines = text.split("\n")
    return "agent_pos" in text or "wall_map" in text or any(_is_row(line) for line in lines[:1])


def jaxued(text: str, name: str) -> plan_lib.Plan:
    """Reads a JaxUED level; `name` is the maze's in messages.

    Raises:
      base.UserError: it isn't such a level; the text names the row and column, or the entry.
    """
    rows = [line.strip() for line in text.strip().split("\n")]
    for i, row in enumerate(rows):
        parsing.check_length(len(row), i, len(rows[0]), name)

    grid = np.array([list(row) for row in rows])
    starts, goals = paths.cells(np.isin(grid, list(ARROWS))), paths.cells(grid == "G")
    for what, places in (("agents", starts), ("goals G", goals)):
        if len(places) != 1:
            raise base.UserError(f"{name}: {len(places)} {what}, a JaxUED level has 1")
    return _level("JaxUED level", grid != "#", starts, goals, name)


def minimax(text: str, name: str) -> plan_lib.Plan:
    """Reads a minimax maze from its Python source, or from rows alone.

    Raises:
      base.UserError: it isn't such a maze; the text names the row and column, or the entry.
    """
    lines = text.split("\n")
    first = next((i for i, line in enumerate(lines) if _is_row(line)), len(lines))

    # Rows end at a line with words, or with brackets alone.
    rows = []
    for line in lines[first:]:
        if re.search("[A-Za-z]", line) or not line.strip(" \t[](),"):
            break
        rows.append(line.strip(" \t[],\"'").split())
    return _minimax(rows, _positions(text, "agent_pos"), _positions(text, "goal_pos"), name)


def minimax_json(content: dict[str, Any], name: str) -> plan_lib.Plan:
    """Reads a minimax maze from a JSON object with `wall_map`, `agent_pos` and `goal_pos`.

    Raises:
      base.UserError: it isn't such a maze; the text names the row and column, or the entry.
    """
    rows = content.get("wall_map")
    if not isinstance(rows, list):
        raise base.UserError(f"{name}: a JSON object without a list 'wall_map' is no minimax maze")
    split = [row.split() if isinstance(row, str) else row for row in rows]
    if not all(isinstance(row, list) for row in split):
        raise base.UserError(f"{name}: wall_map must be a list of rows")

    # Positions are searched in text, as in a source, so that lists and strings are read alike.
    agent, goal = (f"{key} = {content.get(key)}" for key in ("agent_pos", "goal_pos"))
    cells = [[str(int(c)) if isinstance(c, bool) else str(c) for c in row] for row in split]
    return _minimax(cells, _positions(agent, "agent_pos"), _positions(goal, "goal_pos"), name)


def _minimax(
    rows: list[list[str]], starts: list[paths.Cell], goals: list[paths.Cell], name: str
) -> plan_lib.Plan:
    if not rows or not rows[0]:
        raise base.UserError(f"{name}: no rows of 0 and 1, so no minimax maze")
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if cell not in ("0", "1"):
                raise base.UserError(
                    f"{name}: unknown cell {cell[:20]!r} at row {i + 1}, column {j + 1}; known "
                    "are 0 and 1"
                )
        parsing.check_length(len(row), i, len(rows[0]), name)
    if len(starts) > 1:
        raise base.UserError(f"{name}: {len(starts)} places in agent_pos, a minimax maze has 1")
    return _level("minimax maze", np.array(rows) == "0", starts, goals, name)


def _level(
    kind: str, free: np.ndarray, starts: list[paths.Cell], goals: list[paths.Cell], name: str
) -> plan_lib.Plan:
    """Returns the plan of inner cells: the outer wall never belongs to a level."""
    return plan_lib.of_free(
        kind,
        free,
        starts=starts,
        goals=goals,
        always_ringed=True,
        num_decisions=plan_lib.solver_limit(free.shape),
        name=name,
    )


def _is_row(line: str) -> re.Match[str] | None:
    """Matches a row of zeros and ones; the list of a `maze_map` has commas between them."""
    found = _ROW.fullmatch(line)
    return found if found and len(found[1]) > 1 else None


def _positions(text: str, word: str) -> list[paths.Cell]:
    """Returns the positions that follow a word, x and y, as cells (row, column)."""
    _, _, after = text.partition(word)
    # Up to the next name: what follows belongs to something else.
    after = re.split(r"[A-Za-z_]{2,}", after, maxsplit=1)[0]
    found = [[int(n) for n in match if n] for match in _POSITION.findall(after)]
    return [(y, x) for x, y in found]
