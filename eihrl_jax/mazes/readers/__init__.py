"""Reads mazes of other projects; the format is recognised by the file's content, not its name."""

import pathlib
import re

from eihrl_jax import base
from eihrl_jax.config import reading as reading_config
from eihrl_jax.mazes import parsing
from eihrl_jax.mazes.readers import levels, lists, moving_ai, pictures
from eihrl_jax.mazes.readers.plan import Plan, solver_limit
from eihrl_jax.storage import reading

__all__ = ["OURS", "Plan", "exists", "read", "solver_limit"]

OURS = "maze"
"""The kind of our own files."""

MAX_BYTES = 4 * parsing.MAX_SIZE**2
"""Size above which a file that is no picture can't be a maze."""

_YAML = re.compile(r"(\s*#[^\n]*\n|\s*\n)*(---|%YAML|!|&|[A-Za-z_]\w*[ \t]*:([ \t]|\n|$))")


def read(path: pathlib.Path, options: reading_config.ReadingConfig, name: str) -> Plan:
    """Reads the plan of a maze from a file of any kind that is known.

    Args:
      path: the file.
      options: what the file leaves open.
      name: how messages call the maze.

    Raises:
      base.UserError: the file can't be read, or is no maze of its kind.
    """
    data = _bytes(path, name)
    if pictures.format_of(data, name) is not None:
        return pictures.of_picture(data, options, name).with_places(options, name)
    if data.startswith(b"\x93NUMPY"):
        return lists.of_npy(data, options, name).with_places(options, name)

    text = _text(data, name)
    return _of_text(text, path, options, name).with_places(options, name)


def exists(path: pathlib.Path) -> bool:
    """Returns whether a file of this name exists; false for impossible names."""
    try:
        return path.exists()
    except OSError as error:
        raise base.UserError(f"maze {str(path)!r}: {error.strerror}") from error
    except ValueError:
        return False


def _of_text(
    text: str, path: pathlib.Path, options: reading_config.ReadingConfig, name: str
) -> Plan:
    """Reads a text; one that no other format matches is read as ours."""
    first = text.lstrip()[:1]
    if first == "{" or (first == "[" and "agent_pos" not in text):
        return lists.of_json(text, options, name)
    if moving_ai.is_map(text):
        beside = path.with_name(path.name + moving_ai.SUFFIX)
        scenarios = _text(_bytes(beside, name), name) if beside.is_file() else None
        return moving_ai.of_map(text, scenarios, options, name)
    if moving_ai.is_scenarios(text):
        of_map = _text(_bytes(moving_ai.map_of(text, path, name), name), name)
        return moving_ai.of_map(of_map, text, options, name)

    if levels.is_jaxued(text):
        return levels.jaxued(text, name)
    if levels.is_minimax(text):
        return levels.minimax(text, name)
    if _YAML.match(text):
        return pictures.of_ros(text, path, options, name)
    if "\\" in text and "#" in text:
        return lists.of_d4rl(text, name)
    head, grid = parsing.read_grid(text, name)
    return Plan(OURS, grid, head=head)


def _bytes(path: pathlib.Path, name: str) -> bytes:
    """Reads a file that isn't too large to be a maze."""
    try:
        if not path.is_file():
            raise base.UserError(f"{name}: {'not a file' if path.exists() else 'no such file'}")
        data = reading.read_bytes(path, limit=pictures.MAX_BYTES)
    except OSError as error:
        raise base.UserError(f"{name}: {error.strerror}") from error

    # What is no picture holds a character or a few for each cell.
    is_picture = any(data.startswith(first) for first in pictures.FORMATS)
    if not is_picture and len(data) > MAX_BYTES:
        raise base.UserError(f"{name}: {len(data)} bytes, at most {MAX_BYTES}")
    return data


def _text(data: bytes, name: str) -> str:
    """Decodes a text, its lines ended as on Unix."""
    try:
        text = data.decode("utf-8-sig")  # some editors write a byte order mark
    except UnicodeDecodeError as error:
        raise base.UserError(f"{name}: not a text in UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")
