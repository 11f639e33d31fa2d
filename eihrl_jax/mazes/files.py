"""Mazes by name, by the name of their suite, and from files of many kinds; our own files."""

import pathlib
from collections.abc import Iterable

from eihrl_jax import base
from eihrl_jax.config import reading
from eihrl_jax.mazes import parsing, readers, suites
from eihrl_jax.mazes.maze import Maze

NAMES = ("random", "u", "s", "spiral", "g1", "g2", "g3")
"""Names of the paper's mazes."""


def load(
    name_or_path: str | pathlib.Path,
    *,
    num_decisions: int | None = None,
    options: reading.ReadingConfig | None = None,
    on_host: bool = False,
) -> Maze:
    """Loads a maze by its name, the paper's or one of a suite, or from a file of any known kind.

    Args:
      name_or_path: one of `NAMES`, a name such as `jaxued-labyrinth` (see `suites.mazes`), else the
        path of a file, see `docs/mazes.md`.
      num_decisions: time limit in subgoals; None: that of the suite, file or kind of file if it has
        one, else see `parsing.default_limit`.
      options: what a file leaves open.
      on_host: leave its arrays to NumPy, which starts no device of JAX.

    Raises:
      base.UserError: unknown name, a suite's, unreadable file, or a file that is no maze; a start
        or goal was chosen for a maze by name.

    >>> int(load("spiral").num_goals), int(load("spiral").num_decisions)
    (5, 200)
    """
    name = str(name_or_path)
    named = suites.find(name)
    if named is None:
        plan = read(name, options)
        return of_plan(plan, name, num_decisions=num_decisions, on_host=on_host)
    if options is not None and (options.start is not None or options.goal is not None):
        raise base.UserError(f"maze {name!r}: a maze by name has a start and goal of its own")
    return parsing.parse(
        named.text,
        name=name,
        num_decisions=named.num_decisions if num_decisions is None else num_decisions,
        start_jitter=named.start_jitter,
        on_host=on_host,
    )


def load_all(
    names: Iterable[str],
    *,
    num_decisions: int | None = None,
    options: reading.ReadingConfig | None = None,
) -> dict[str, Maze]:
    """Loads several mazes; the name of a suite stands for all of its mazes.

    Args:
      names: see `load`, and `suites.NAMES`.
      num_decisions: time limit in subgoals of all; None: see `load`.
      options: what files leave open, of all of them.

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
            chosen[label] = load(each, num_decisions=num_decisions, options=options)
    return chosen


def read(path: str | pathlib.Path, options: reading.ReadingConfig | None = None) -> readers.Plan:
    """Reads the plan of a maze from a file of any kind that is known, see `load`.

    Raises:
      base.UserError: the file can't be read, or is no maze of its kind.
    """
    maze = f"maze {str(path)!r}"
    if str(path) in suites.NAMES:
        mazes = ", ".join(suites.mazes(str(path)))
        raise base.UserError(f"{maze}: a suite of several mazes, name one of {mazes}")
    if not readers.exists(pathlib.Path(path)):
        known = f"one of {', '.join(NAMES)}, nor a maze of {', '.join(suites.NAMES[1:])}"
        hint = base.did_you_mean(str(path), suites.all_names())
        raise base.UserError(f"{maze}: neither a file nor {known}; {hint}".rstrip("; "))
    return readers.read(pathlib.Path(path), options or reading.ReadingConfig(), maze)


def of_plan(
    plan: readers.Plan, name: str, *, num_decisions: int | None = None, on_host: bool = False
) -> Maze:
    """Makes a maze of what `read` returned.

    Args:
      plan: the maze as its file has it.
      name: how messages call the maze.
      num_decisions: time limit in subgoals; None: see `load`.
      on_host: see `load`.

    Raises:
      base.UserError: it is no maze.
    """
    limit = plan.num_decisions if num_decisions is None else num_decisions
    return parsing.parse(
        plan.text, name=name, num_decisions=limit, first=plan.first, on_host=on_host
    )


def save(path: str | pathlib.Path, maze: Maze) -> None:
    """Writes a maze as one of our files, from which `load` makes the same maze again.

    Args:
      path: a new file.
      maze: one maze, no candidate drawn.

    Raises:
      base.UserError: the file exists, or can't be written.
    """
    try:
        # "x": what is there, a planted link as well, is never written over.
        with pathlib.Path(path).open("x", encoding="utf-8") as file:
            file.write(parsing.text_of(maze))
    except FileExistsError:
        raise base.UserError(f"{path} exists; a maze is saved to a new file") from None
    except OSError as error:
        raise base.UserError(f"{path}: {error.strerror}") from None
