"""Writes files whole: a kill leaves the old one or the new one, and no link is written through."""

import contextlib
import os
import pathlib
import shutil
from collections.abc import Iterator
from typing import BinaryIO

TEMPORARY = ".incomplete-"
"""What names of unfinished files and folders begin with."""


def write_text(path: pathlib.Path, text: str) -> None:
    """Writes a text in UTF-8, see `new_file`."""
    with new_file(path) as file:
        file.write(text.encode("utf-8"))


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
    temporary = path.with_name(f"{TEMPORARY}{path.name}")
    discard(temporary)  # of a killed process, or a link that somebody has put there
    try:
        with temporary.open("xb") as file:
            yield file
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        # A full disk is noticed by an open file, which tells no name.
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise


def discard(path: pathlib.Path) -> None:
    """Removes a file, a folder with all that is in it, or a link and not what it leads to.

    Raises:
      OSError: it can't be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def append(path: pathlib.Path) -> BinaryIO:
    """Opens a file to add to its end, made if it isn't there; a link is refused.

    Raises:
      OSError: it is a link, or may not be written.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.fdopen(os.open(path, flags, 0o644), "ab", buffering=0)
