"""Output folders: checks that they are empty, and locks against other processes."""

import contextlib
import fcntl
import os
import pathlib
from collections.abc import Iterator

from eihrl_jax import base
from eihrl_jax.storage import reading, writing

LOCK = ".lock"
"""Name of the file by which a process keeps others out of its folder."""

UNFINISHED = f"{writing.TEMPORARY}task"
"""Name of the file that says what a folder was being filled with when its process was killed."""


class TakenError(base.UserError):
    """Another process is writing to a folder."""


@contextlib.contextmanager
def reserved(out: pathlib.Path, task: str = "") -> Iterator[None]:
    """Creates a folder and locks it against other processes, so that nothing is overwritten.

    A folder in which nothing has been written by the end is removed again.

    Args:
      out: the folder.
      task: describes the content; the folder of a stopped process with the same task is continued.
        Empty: none is.

    Raises:
      base.UserError: `out` is a file, a folder that isn't empty, or locked by another process.
    """
    _check_empty(out, task)
    with locked(out):
        _check_empty(out, task)  # another may have filled it since
        if task:
            writing.write_text(out / UNFINISHED, task)
        try:
            yield
            (out / UNFINISHED).unlink(missing_ok=True)
        finally:
            if not holds_something(out):
                (out / UNFINISHED).unlink(missing_ok=True)


@contextlib.contextmanager
def locked(out: pathlib.Path) -> Iterator[None]:
    """Creates a folder if it doesn't exist, and locks it against other processes.

    A folder that is empty at the end is removed.

    Raises:
      TakenError: another process is writing to it.
    """
    out.mkdir(parents=True, exist_ok=True)
    lock = take_lock(out)
    try:
        yield
    finally:
        # Unlinked while still locked: otherwise the lock of another process could be removed.
        (out / LOCK).unlink(missing_ok=True)
        os.close(lock)
        if not any(out.iterdir()):
            out.rmdir()


def _check_empty(out: pathlib.Path, task: str) -> None:
    if not holds_something(out):
        return
    file = out / UNFINISHED
    if not task or not file.is_file() or reading.read_text(file) != task:
        raise base.UserError(f"out = {out} is not empty; name a new or empty folder")


def check_free(path: pathlib.Path, *, resume: bool) -> bool:
    """Returns whether a folder isn't empty, which is allowed only with `resume`.

    Raises:
      UserError: it isn't empty and `resume` is false, or it isn't a folder.
    """
    is_taken = holds_something(path)
    if is_taken and not resume:
        raise base.UserError(f"{path} exists already: go on with --resume or name another --run")
    return is_taken


def holds_something(path: pathlib.Path) -> bool:
    """Returns whether a folder holds more than the leftovers of a killed start.

    Raises:
      UserError: it isn't a folder.
    """
    if not path.exists():
        return False
    if not path.is_dir():
        raise base.UserError(f"{path} is a file, not a folder")
    names = [entry.name for entry in path.iterdir()]
    return any(name != LOCK and not name.startswith(writing.TEMPORARY) for name in names)


def take_lock(path: pathlib.Path) -> int:
    """Locks the folder for as long as this process lives, and returns the lock's file descriptor.

    Raises:
      TakenError: another process holds the lock.
    """
    # A lock on the open file, not its existence: the system releases it when the process dies.
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    descriptor = os.open(path / LOCK, flags, 0o644)
    with contextlib.suppress(BlockingIOError, FileNotFoundError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The former holder may have removed the file since it was opened: then it locks nothing.
        if os.path.samestat(os.fstat(descriptor), (path / LOCK).lstat()):
            return descriptor
    os.close(descriptor)
    raise TakenError(f"{path} is being written to by another process")


def check_unlocked(path: pathlib.Path) -> None:
    """Checks that no other process is writing to a folder, which needn't exist.

    Raises:
      TakenError: another process is.
    """
    if (path / LOCK).exists():
        os.close(take_lock(path))
