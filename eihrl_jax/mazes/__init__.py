"""Mazes as text, as pytrees, and as random rooms.

`load` knows the paper's seven mazes by name (Figures 1 and 4; time limits of Table 3 divided by 25)
and reads any other maze from a text file.
"""

import pathlib

from eihrl_jax import base
from eihrl_jax.mazes import layouts, maze, parsing, paths
from eihrl_jax.mazes.maze import Maze
from eihrl_jax.mazes.parsing import parse, stack

__all__ = ["NAMES", "Maze", "layouts", "load", "maze", "parse", "parsing", "paths", "stack"]

_TEXT_AND_LIMIT = {
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
    """
    name = str(name_or_path)
    if name not in NAMES:
        return parse(_read(pathlib.Path(name)), name=name, num_decisions=num_decisions)
    text, limit = _TEXT_AND_LIMIT[name]
    return parse(
        text,
        name=name,
        num_decisions=limit if num_decisions is None else num_decisions,
        start_jitter=0.75 if name == "random" else 0.5,
    )


def _read(path: pathlib.Path) -> str:
    """Reads the text of a maze file."""
    try:
        if not path.exists():
            names = ", ".join(NAMES)
            raise base.UserError(f"maze {str(path)!r}: neither a file nor one of {names}")
        if not path.is_file():
            raise base.UserError(f"maze {str(path)!r}: not a file")
        if path.stat().st_size > _MAX_BYTES:
            raise base.UserError(
                f"maze {str(path)!r}: {path.stat().st_size} bytes, at most {_MAX_BYTES}"
            )
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise base.UserError(f"maze {str(path)!r}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise base.UserError(f"maze {str(path)!r}: not a text in UTF-8") from error
