"""Arrays by name in one file with a checksum; nothing in it is ever unpickled."""

import hashlib
import io
import pathlib
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from eihrl_jax import base
from eihrl_jax.storage import reading, writing

MAX_SIZE = 2**28
"""Most bytes that the arrays of an archive may have where nothing else is said: few pack many."""

_CHECKSUM = 64
"""Bytes of the checksum at the end of a file: SHA-256 of all before it, in hexadecimal."""

_UNREADABLE = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    RuntimeError,  # also NotImplementedError
    MemoryError,
    zipfile.BadZipFile,
)
"""What NumPy and its archives raise where their content makes no sense."""


def write(path: pathlib.Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes arrays as .npz with a checksum; what was at `path` is replaced whole or not at all."""
    archive = io.BytesIO()
    named: dict[str, Any] = {**arrays}  # NumPy has a keyword of another type
    np.savez_compressed(archive, **named)
    # As the archive's last comment, which NumPy passes over.
    with zipfile.ZipFile(archive, "a") as file:
        file.comment = bytes(_CHECKSUM)
    body = archive.getvalue()[:-_CHECKSUM]
    with writing.new_file(path) as file:
        file.write(body + _checksum(body))


def read(path: pathlib.Path, *, limit: int = MAX_SIZE) -> dict[str, np.ndarray]:
    """Reads what `write` wrote.

    Args:
      path: of the file.
      limit: most bytes that it and its arrays may have.

    Raises:
      base.UserError: it is damaged, no file of this kind, or too large.
      OSError: it isn't there, or may not be read.
    """
    data = reading.read_bytes(path, limit=limit)
    # Before NumPy looks at it: a changed bit may still make an archive of other numbers.
    if data[-_CHECKSUM:] != _checksum(data[:-_CHECKSUM]):
        raise base.UserError(f"{path} is damaged, or from an earlier version")
    try:
        size = sum(each.file_size for each in zipfile.ZipFile(io.BytesIO(data)).infolist())
        if size > limit:
            raise ValueError(f"it has arrays of {size} bytes, at most {limit}")
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except _UNREADABLE as error:
        raise base.UserError(f"{path} can't be read: {error}") from None
    for name, array in arrays.items():  # NumPy gives what is none as it is
        if not isinstance(array, np.ndarray):
            raise base.UserError(f"{path} can't be read: {name!r} is no array")
    return arrays


def _checksum(data: bytes) -> bytes:
    """Returns the checksum of an archive without its comment."""
    return hashlib.sha256(data).hexdigest().encode("ascii")
