"""Mazes by name, and mazes from text files.

The paper's seven mazes have names (Figures 1 and 4); their time limits are those of Table 3 divided
by 25, the control steps per subgoal.
"""

import pathlib

from eihrl_jax import base
from eihrl_jax.mazes import layouts, parsing
from eihrl_jax.mazes.maze import Maze

_TEXT_AND_LIMIT = {  # limits in subgoals (paper, Table 3 over 25)
    "random": (layouts.RANDOM, 24),
    "u": (layouts.U, 24),
    "s": (layouts.S, 40),
    "spiral": (layouts.SPIRAL, 200),
    "g1": (layouts.G1, 24),
    "g2": (layouts.G2, 24),
    "g3": (layouts.G3, 24),
}

NAMES = tuple(_TEXT_AND_LIMIT)
"""Names of the paper's mazes."""

_MAX_BYTES = 4 * parsing.MAX_SIZE**2
"""Size above which a file can't be a maze."""


def load(name_or_path: str | pathlib.Path, *, num_decisions: int | None = None) -> Maze:
    """Loads one of the paper's mazes by name, or a maze from a text file.

    Args:
      name_or_path: one of `NAMES`, else the path of a text file (legend: `parsing`).
      num_decisions: time limit in subgoals; None: the paper's, for a file see `parsing.parse`.

    Raises:
      base.UserError: unknown name, unreadable file, or a text that is not a maze.

    >>> int(load("spiral").num_goals), int(load("spiral").num_decisions)
    (5, 200)
    """
    name = str(name_or_path)
    if name not in NAMES:
        return parsing.parse(_read(pathlib.Path(name)), name=name, num_decisions=num_decisions)

    text, limit = _TEXT_AND_LIMIT[name]
    return parsing.parse(
        text,
        name=name,
        num_decisions=limit if num_decisions is None else num_decisions,
        # Paper: only the Random Square starts anywhere (App. D.1); the widths are ours.
        start_jitter=0.75 if name == "random" else 0.5,
    )


def _read(path: pathlib.Path) -> str:
    """Reads the text of a maze file."""
    maze = f"maze {str(path)!r}"
    try:
        if not path.exists():
            raise base.UserError(f"{maze}: neither a file nor one of {', '.join(NAMES)}")
        if not path.is_file():
            raise base.UserError(f"{maze}: not a file")
        # Asked before it is read: any file may have been named by mistake.
        size = path.stat().st_size
        if size > _MAX_BYTES:
            raise base.UserError(f"{maze}: {size} bytes, at most {_MAX_BYTES}")
        return path.read_text(encoding="utf-8-sig")  # some editors write a byte order mark
    except OSError as error:
        raise base.UserError(f"{maze}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise base.UserError(f"{maze}: not a text in UTF-8") from error
