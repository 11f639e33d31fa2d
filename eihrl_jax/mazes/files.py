"""Mazes by name, by the name of their suite, and from text files."""

import pathlib
from collections.abc import Iterable

from eihrl_jax import base
from eihrl_jax.mazes import parsing, suites
from eihrl_jax.mazes.maze import Maze

NAMES = ("random", "u", "s", "spiral", "g1", "g2", "g3")
"""Names of the paper's mazes."""

_MAX_BYTES = 4 * parsing.MAX_SIZE**2
"""Size above which a file can't be a maze."""


def load(name_or_path: str | pathlib.Path, *, num_decisions: int | None = None) -> Maze:
    """Loads a maze by its name, the paper's or one of a suite, or from a text file.

    Args:
      name_or_path: one of `NAMES`, a name such as `jaxued-labyrinth` (see `suites.mazes`), else the
        path of a text file (legend: `parsing`).
      num_decisions: time limit in subgoals; None: the suite's own if it has one, else see
        `parsing.parse`.

    Raises:
      base.UserError: unknown name, a suite's, unreadable file, or a text that is not a maze.

    >>> int(load("spiral").num_goals), int(load("spiral").num_decisions)
    (5, 200)
    """
    name = str(name_or_path)
    named = suites.find(name)
    if named is None:
        return parsing.parse(_read(pathlib.Path(name)), name=name, num_decisions=num_decisions)
    return parsing.parse(
        named.text,
        name=name,
        num_decisions=named.num_decisions if num_decisions is None else num_decisions,
        start_jitter=named.start_jitter,
    )


def load_all(names: Iterable[str], *, num_decisions: int | None = None) -> dict[str, Maze]:
    """Loads several mazes; the name of a suite stands for all of its mazes.

    Args:
      names: see `load`, and `suites.NAMES`.
      num_decisions: time limit in subgoals of all; None: see `load`.

    Returns:
      The mazes by their labels: names, or the stems of files.

    Raises:
      base.UserError: see `load`; two mazes would have the same label.
    """
    chosen: dict[str, Maze] = {}
    for name in names:
        for each in suites.mazes(name) if name in suites.NAMES else [name]:
            label = each if suites.find(each) else pathlib.Path(each).stem
            # Labels name the files of results, so two files `maze.txt` can't be told apart there.
            if label in chosen:
                raise base.UserError(f"mazes: {each!r} would be the second one called {label!r}")
            chosen[label] = load(each, num_decisions=num_decisions)
    return chosen


def _read(path: pathlib.Path) -> str:
    """Reads the text of a maze file."""
    maze = f"maze {str(path)!r}"
    if str(path) in suites.NAMES:
        mazes = ", ".join(suites.mazes(str(path)))
        raise base.UserError(f"{maze}: a suite of several mazes, name one of {mazes}")

    try:
        if not path.exists():
            known = f"one of {', '.join(NAMES)}, nor a maze of {', '.join(suites.NAMES[1:])}"
            raise base.UserError(f"{maze}: neither a file nor {known}")
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
