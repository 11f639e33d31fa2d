r"""MovingAI's maps (`type octile`) and scenarios (`version 1`), which name a start and a goal each.

Passable are `.`, `G` and `S` (swamp); `@`, `O`, `T` (trees) and `W` (water) are wall. A scenario
file is `<map's file name>.scen`, and is used where a map of that name is read; it may also be read
itself. Our robots move in four directions, MovingAI's agents in eight: a way exists for both or for
none, as corners aren't cut there, but the optimal lengths of scenarios are of the latter.

Source: N. R. Sturtevant, Benchmarks for Grid-Based Pathfinding, IEEE Transactions on Computational
  Intelligence and AI in Games 4 (2012); movingai.com/benchmarks/formats.html.
"""

import pathlib
import re

import numpy as np

from eihrl_jax import base
from eihrl_jax.config import reading
from eihrl_jax.mazes import parsing
from eihrl_jax.mazes.readers import plan as plan_lib

SUFFIX = ".scen"

_FREE, _WALL = ".GS", "@OTW"
_NUM_FIELDS = 9


def is_map(text: str) -> bool:
    """Returns whether a text begins as a map does."""
    return re.match(r"type\s", text) is not None


def is_scenarios(text: str) -> bool:
    """Returns whether a text begins as a scenario file does."""
    return re.match(r"version\s", text) is not None


def of_map(
    text: str, scenarios: str | None, options: reading.ReadingConfig, name: str
) -> plan_lib.Plan:
    """Reads a map.

    Args:
      text: the map.
      scenarios: the file of its scenarios; None: the maze has no start and goal yet.
      options: `scenario` is the number of the scenario whose start and goal are taken.
      name: the maze's in messages.

    Raises:
      base.UserError: it isn't such a map, or the scenario isn't one of this map.
    """
    lines = [line.rstrip() for line in text.rstrip().split("\n")]
    height, width = _header(lines[:4], name)
    rows = lines[4:]
    if len(rows) != height:
        raise base.UserError(f"{name}: {len(rows)} rows, but height is {height}")

    for i, row in enumerate(rows):
        if len(row) != width:
            raise base.UserError(
                f"{name}: row {i + 1} has {len(row)} columns, but width is {width}"
            )
        for j, character in enumerate(row):
            if character not in _FREE + _WALL:
                raise base.UserError(
                    f"{name}: unknown character {character!r} at row {i + 1}, column {j + 1}; "
                    f"known are {' '.join(_FREE + _WALL)}"
                )
    free = np.isin([list(row) for row in rows], list(_FREE))

    if scenarios is None:
        return plan_lib.of_free("MovingAI map", free, name=name)
    x0, y0, x1, y1 = _scenario(scenarios, options.scenario, (height, width), name)
    return plan_lib.of_free("MovingAI map", free, starts=[(y0, x0)], goals=[(y1, x1)], name=name)


def map_of(scenarios: str, path: pathlib.Path, name: str) -> pathlib.Path:
    """Returns the path of the map that a scenario file belongs to, in the same folder."""
    # By the scenario file's name first: the name inside often has folders of another computer.
    beside = path.with_suffix("")
    if path.suffix == SUFFIX and beside.is_file():
        return beside
    inside = _fields(scenarios, 1, name)[1].replace("\\", "/")
    return path.parent / pathlib.PurePosixPath(inside).name


def _header(lines: list[str], name: str) -> tuple[int, int]:
    """Reads height and width from the four lines above the rows."""
    words = [line.split() for line in lines]
    kinds = [word[0] if word else "" for word in words]
    if kinds != ["type", "height", "width", "map"] and kinds != ["type", "width", "height", "map"]:
        raise base.UserError(
            f"{name}: the header of a MovingAI map is type, height, width and map, one a line"
        )
    if words[0][1:] != ["octile"]:
        raise base.UserError(f"{name}: {lines[0][:40]!r}, must be 'type octile'")

    sizes = {word[0]: _whole(word[1:], f"{name}: {word[0]}") for word in words[1:3]}
    return sizes["height"], sizes["width"]


def _whole(words: list[str], what: str) -> int:
    """Reads one number of cells."""
    if len(words) != 1 or not re.fullmatch(r"\d{1,6}", words[0], re.ASCII):
        raise base.UserError(f"{what} is {' '.join(words)[:40]!r}, must be a number of cells")
    number = int(words[0])
    if not 1 <= number <= parsing.MAX_SIZE:
        raise base.UserError(f"{what} = {number} must be at least 1 and at most {parsing.MAX_SIZE}")
    return number


def _fields(text: str, number: int, name: str) -> list[str]:
    """Returns the fields of a scenario; number 0 is the last one."""
    first, *lines = [line for line in text.split("\n") if line.strip()]
    if first.split() not in (["version", "1"], ["version", "1.0"]):
        raise base.UserError(f"{name}: scenarios begin with {first[:40]!r}, must be 'version 1'")
    if not 1 <= (number or len(lines)) <= len(lines):
        raise base.UserError(f"{name}: scenario = {number}, but there are {len(lines)}")

    fields = lines[number - 1].split("\t")
    # Some copies have blanks in place of tabs; where there are tabs, names may hold blanks.
    if len(fields) == 1:
        fields = fields[0].split()
    if len(fields) != _NUM_FIELDS:
        raise base.UserError(
            f"{name}: scenario {number or len(lines)} has {len(fields)} fields, must have "
            f"{_NUM_FIELDS}"
        )
    return fields


def _scenario(text: str, number: int, shape: tuple[int, int], name: str) -> tuple[int, ...]:
    """Returns x and y of a scenario's start and goal."""
    fields = _fields(text, number, name)
    for word in fields[2:8]:
        if not re.fullmatch(r"\d{1,6}", word, re.ASCII):
            raise base.UserError(f"{name}: scenario with {word[:40]!r}, must be a number of cells")
    width, height, *places = map(int, fields[2:8])
    if (height, width) != shape:
        raise base.UserError(
            f"{name}: the scenario is of a map of {height} x {width}, but this has "
            f"{shape[0]} x {shape[1]}"
        )
    return tuple(places)
