"""Reads untrusted files: regular files of bounded size, text in UTF-8, JSON and TOML.

A pipe or a device under a file's name would block or fill the memory, and an integer of a thousand
digits or a thousand nested lists end in errors far from their cause. Each is a `UserError` here.
"""

import json
import os
import pathlib
import stat
import tomllib
from typing import Any, TypeAlias

from eihrl_jax import base

MAX_BYTES = 2**26
"""Largest file that is read where nothing else is said."""

MAX_DEPTH = 64
"""Most lists and objects within each other in JSON and TOML."""

MAX_INT = 2**63 - 1
"""Largest magnitude of an integer in JSON and TOML."""

Value: TypeAlias = Any
"""What JSON or TOML holds: dicts, lists, texts, numbers, truth values, None."""


def read_bytes(path: pathlib.Path, *, limit: int = MAX_BYTES) -> bytes:
    """Reads a regular file.

    Args:
      path: of the file; a link is followed.
      limit: most bytes that it may have.

    Raises:
      base.UserError: it is a folder, a pipe or a device, or larger than `limit`.
      OSError: it isn't there, or may not be read.
    """
    # Without waiting for anybody to write, should it be a pipe.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise base.UserError(f"{path} is no regular file")

    # Some files of the system have 0 bytes and go on for ever: one more than may be is enough.
    with os.fdopen(descriptor, "rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        size = max(status.st_size, len(data))
        raise base.UserError(f"{path} has {size} bytes, at most {limit}")
    return data


def read_text(path: pathlib.Path, *, limit: int = MAX_BYTES) -> str:
    """Reads a text in UTF-8, see `read_bytes`; lines end as they are written.

    Raises:
      base.UserError: it is no such text.
    """
    try:
        return read_bytes(path, limit=limit).decode("utf-8-sig")  # editors write a byte order mark
    except UnicodeDecodeError as error:
        raise base.UserError(f"{path} is no text in UTF-8: byte {error.start}") from None


def read_json(path: pathlib.Path) -> Value:
    """Reads a JSON file, see `parse_json`."""
    return parse_json(read_text(path), str(path))


def parse_json(text: str, source: str) -> Value:
    """Reads JSON text.

    Args:
      text: to read.
      source: where it comes from, for the error.

    Raises:
      base.UserError: it is no JSON, nested more than `MAX_DEPTH` deep, or has an integer beyond
        `MAX_INT`.
    """
    try:
        value = json.loads(text)
    except RecursionError:
        raise base.UserError(f"{source} is nested more than {MAX_DEPTH} deep") from None
    except ValueError as error:
        raise base.UserError(f"{source} is no JSON: {error}") from None
    _check(value, source)
    return value


def read_toml(path: pathlib.Path) -> dict[str, Value]:
    """Reads a TOML file.

    Raises:
      base.UserError: as of `parse_json`.
    """
    try:
        value = tomllib.loads(read_text(path).replace("\r\n", "\n"))
    except RecursionError:
        raise base.UserError(f"{path} is nested more than {MAX_DEPTH} deep") from None
    except ValueError as error:
        raise base.UserError(f"{path} is no TOML: {error}") from None
    _check(value, str(path))
    return value


def _check(value: Value, source: str) -> None:
    """Checks how deep a value is nested, and how large its integers are."""
    level, depth = [value], 0
    while level:
        if depth > MAX_DEPTH:
            raise base.UserError(f"{source} is nested more than {MAX_DEPTH} deep")
        inner = []
        for each in level:
            if isinstance(each, dict):
                inner += each.values()
            elif isinstance(each, list):
                inner += each
            elif isinstance(each, int) and abs(each) > MAX_INT:
                raise base.UserError(f"{source}: an integer is beyond {MAX_INT}")
        level, depth = inner, depth + 1
