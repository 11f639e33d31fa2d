"""Suites: test mazes of other projects by name, with origin and licence.

Layouts stand in our legend (see `parsing`) in a TOML file per suite; perfect mazes are generated.
"""

import dataclasses
import functools
import pathlib
from collections.abc import Collection, Mapping
from typing import Any

from eihrl_jax.mazes import layouts, perfect, readers
from eihrl_jax.mazes.suites import development
from eihrl_jax.storage import reading

NUM_PERFECT = 10
"""Perfect mazes of each size; their seeds are 0 and up."""

_SIDES = {"perfect-19": 19, "perfect-51": 51, "perfect-101": 101}
"""Cells a side of the perfect mazes, without the outer wall."""

DEVELOPMENT = "development"
"""Generated mazes in which options are compared, see `development`."""

NAMES = ("paper", "jaxued", "ogbench", "jaxgcrl", "gymnasium-robotics", *_SIDES, DEVELOPMENT)
"""Names of the suites."""

_MINIMAX = "minimax's Maze-PerfectMaze, https://github.com/facebookresearch/minimax"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Named:
    """A maze that has a name.

    Attributes:
      text: see `parsing`.
      origin: where it comes from.
      licence: of what it comes from.
      num_decisions: the suite's own time limit in subgoals; None: it has none for our robots.
      start_jitter: see `parsing.parse`.
    """

    text: str
    origin: str
    licence: str
    num_decisions: int | None = None
    start_jitter: float = 0.5


@functools.cache
def mazes(suite: str) -> Mapping[str, Named]:
    """Returns the mazes of a suite by their names, which begin with its, but for the paper's.

    >>> list(mazes("ogbench"))[:2]
    ['ogbench-medium-1', 'ogbench-medium-2']
    """
    if suite == "paper":
        return _of_paper()
    if suite in _SIDES:
        return _perfect(suite, _SIDES[suite])
    if suite == DEVELOPMENT:
        return _of_development()

    table = reading.read_toml(pathlib.Path(__file__).parent / f"{suite}.toml")
    named: dict[str, Named] = {}
    for name, entry in table["mazes"].items():
        texts = _tasks(entry) if "tasks" in entry else {"": entry["text"]}
        for task, text in texts.items():
            named[f"{suite}-{name}{task}"] = Named(
                text=text,
                origin=table["origin"],
                licence=table["licence"],
                num_decisions=_by_size(text) if table["has_limit"] else None,
            )
    return named


def find(name: str) -> Named | None:
    """Returns the maze of a name, None where there is no such maze in any suite."""
    # Asked by prefix, so that no suite is generated for the name of a file.
    for suite in NAMES:
        if suite == "paper" or name.startswith(f"{suite}-"):
            if name in mazes(suite):
                return mazes(suite)[name]
    return None


def all_names() -> list[str]:
    """Returns the names of all suites and of all their mazes."""
    return [*NAMES, *(name for suite in NAMES for name in mazes(suite))]


def complete(names: Collection[str]) -> dict[str, list[str]]:
    """Returns the suites all of whose mazes are among some names, with the names of their mazes."""
    begun = [s for s in NAMES if s == "paper" or any(name.startswith(f"{s}-") for name in names)]
    return {suite: list(mazes(suite)) for suite in begun if set(mazes(suite)) <= set(names)}


def _of_paper() -> dict[str, Named]:
    """Returns the paper's seven mazes; limits are those of its Table 3 over 25 steps a subgoal."""
    limits = {"random": 24, "u": 24, "s": 40, "spiral": 200, "g1": 24, "g2": 24, "g3": 24}
    return {
        name: Named(
            text=getattr(layouts, name.upper()),
            origin="the paper, Figures 1 and 4",
            licence="none: facts",
            num_decisions=limit,
            # Paper: only the Random Square starts anywhere (App. D.1); the widths are ours.
            start_jitter=0.75 if name == "random" else 0.5,
        )
        for name, limit in limits.items()
    }


def _perfect(suite: str, side: int) -> dict[str, Named]:
    """Returns perfect mazes of one size."""
    texts = [perfect.perfect_maze(seed, side, side) for seed in range(NUM_PERFECT)]
    return {
        f"{suite}-{seed}": Named(
            text=text,
            origin=f"generated as {_MINIMAX}",
            licence="ours, MIT",
            num_decisions=_by_size(text),
        )
        for seed, text in enumerate(texts)
    }


def _of_development() -> dict[str, Named]:
    """Returns the mazes in which options are compared; rooms have several starts and doors."""
    return {
        f"{DEVELOPMENT}-{name}": Named(
            text=text, origin="generated", licence="ours, MIT", num_decisions=_by_size(text)
        )
        for name, text in development.texts()
    }


def _tasks(entry: Mapping[str, Any]) -> dict[str, str]:
    """Writes each of a maze's tasks, a start and a goal by row and column, into its text."""
    texts = {}
    for number, (start, goal) in enumerate(entry["tasks"], 1):
        rows = [list(row) for row in entry["text"].splitlines()]
        for character, (i, j) in (("S", start), ("1", goal)):
            rows[i][j] = character
        texts[f"-{number}"] = "\n".join("".join(row) for row in rows) + "\n"
    return texts


def _by_size(text: str) -> int:
    """Returns the time limit of JaxUED's and minimax's mazes, outer wall left out."""
    rows = text.split()
    return readers.solver_limit((len(rows) - 2, len(rows[0]) - 2))
