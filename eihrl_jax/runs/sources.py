"""Files that a run is made of, kept in its folder: a path says little of what stood there.

    sources/<option>/<file>     e.g. sources/task.maze/maze.txt

A run that goes on compares what its options name now with what is kept, so that an edited maze is
noticed, and the same maze under another name is the same.
"""

import itertools
import pathlib
from collections.abc import Mapping
from typing import TypeAlias

from eihrl_jax import base
from eihrl_jax.storage import reading, writing

FOLDER = "sources"
"""Name of the folder inside the run's."""

Files: TypeAlias = Mapping[str, bytes]
"""Contents of files by their path below a folder."""

Sources: TypeAlias = Mapping[str, Files]
"""What options name, by option; nothing where one names no file."""

_LARGEST = 2**28  # as the largest file of a robot


def keep(run: pathlib.Path, sources: Sources) -> None:
    """Writes the files into a run's folder, whole, unless some are kept there already."""
    folder = run / FOLDER
    if not any(sources.values()) or folder.exists():
        return
    hidden = run / f"{writing.TEMPORARY}{FOLDER}"
    writing.discard(hidden)  # of a killed process
    hidden.mkdir()
    for option, files in sources.items():
        for name, data in files.items():
            path = hidden / option / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with writing.new_file(path) as file:
                file.write(data)
    hidden.rename(folder)


def kept(run: pathlib.Path, sources: Sources) -> list[str]:
    """Returns the options of whose files a run's folder keeps its own."""
    options = [option for option, files in sources.items() if files]
    return [option for option in options if (run / FOLDER / option).is_dir()]


def check(run: pathlib.Path, sources: Sources) -> None:
    """Compares files with those that a run's folder keeps.

    Raises:
      base.UserError: some differ.
    """
    for option in kept(run, sources):
        folder, files = run / FOLDER / option, sources[option]
        before = [path.relative_to(folder).as_posix() for path in _files(folder)]
        for name in dict.fromkeys([*before, *files]):
            if name not in before or name not in files:
                difference = f"{name} is {'new' if name in files else 'missing'}"
            else:
                old = reading.read_bytes(folder / name, limit=_LARGEST)
                difference = _difference(name, old, files[name])
            if difference:
                raise base.UserError(
                    f"{option} is not what {run} was started with: {difference}; what it was is "
                    f"kept in {folder}"
                )


def _files(folder: pathlib.Path) -> list[pathlib.Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _difference(name: str, old: bytes, new: bytes) -> str:
    """Says where a file differs from an earlier one, "" where it doesn't."""
    if old == new:
        return ""
    try:
        lines = itertools.zip_longest(old.decode().splitlines(), new.decode().splitlines())
        first = next(i for i, (left, right) in enumerate(lines) if left != right)
    except (UnicodeDecodeError, StopIteration):
        return f"{name} differs"  # no text, or in nothing but how its lines end
    return f"{name} differs in line {first + 1}"
