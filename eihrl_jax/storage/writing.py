"""Writes files whole: a kill leaves the old one or the new one, and no link is written through."""

import contextlib
import hashlib
import os
import pathlib
import shutil
from collections.abc import Iterator
from typing import BinaryIO

TEMPORARY = ".incomplete-"
"""What names of unfinished files and folders begin with."""

_MAX_NAME = 255  # bytes, of every common file system


def write_text(path: pathlib.Path, text: str) -> None:
    """Writes a text in UTF-8, see `new_file`; undecodable bytes of file names are escaped."""
    with new_file(path) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


@contextlib.contextmanager
def new_file(path: pathlib.Path) -> Iterator[BinaryIO]:
    """Opens a new file that takes the place of `path` once it is complete.

    A link under that name is replaced, and what it leads to stays as it is.

    Args:
      path: of the file; whatever is there is replaced at once or, after an error, not at all.

    Raises:
      OSError: it can't be written; the error has its name.
    """
    # In the same folder: only within one file system is a replacement atomic.
    temporary = temporary_of(path)
    discard(temporary)  # of a killed process, or a link that somebody has put there
    try:
        with named(path), temporary.open("xb") as file:
            yield file
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def named(path: pathlib.Path) -> Iterator[None]:
    """Gives errors of the system the name of a file: an open one that finds its disk full has none.

    Raises:
      OSError: the block's own.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def temporary_of(path: pathlib.Path) -> pathlib.Path:
    """Returns where what will be at `path` stands while it is unfinished, in the same folder."""
    return path.with_name(f"{TEMPORARY}{short(path.name, _MAX_NAME - len(TEMPORARY))}")


def short(name: str, limit: int) -> str:
    """Returns a name of a file, cut where it has more bytes; cut ones end in a checksum."""
    data = os.fsencode(name)
    if len(data) <= limit:
        return name
    digest = hashlib.sha256(data).hexdigest()[:8]
    return data[: limit - 9].decode("utf-8", "ignore") + f"-{digest}"


def check_room(folder: pathlib.Path, size: int, done: int = 0) -> None:
    """Checks that the system would take a file, for libraries that can't do without it.

    Args:
      folder: where it is to be.
      size: bytes of the whole file.
      done: bytes of it that are there already.

    Raises:
      OSError: the disk hasn't room for it, or files may not be so large.
    """
    if not hasattr(os, "posix_fallocate"):  # macOS
        return
    path = folder / f"{TEMPORARY}room"
    discard(path)
    try:
        with named(folder), path.open("xb") as file:
            os.posix_fallocate(file.fileno(), done, max(1, size - done))
    finally:
        path.unlink(missing_ok=True)


def discard(path: pathlib.Path) -> None:
    """Removes a file, a folder with all that is in it, or a link and not what it leads to.

    Raises:
      OSError: it can't be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def append(path: pathlib.Path, text: str) -> None:
    """Adds a text to the end of a file, made if it isn't there, on disk when this returns.

    Raises:
      OSError: it is a link, or can't be written; the error has its name.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    with named(path), os.fdopen(os.open(path, flags, 0o644), "ab", buffering=0) as file:
        data = text.encode("utf-8", "backslashreplace")
        while data:  # where there is room for a part, that is written first
            data = data[file.write(data) :]
