"""The folder of one training run: what was run, with what, how it went, and how to go on.

    config.json     the options of the last start, as `codec.to_json` writes them
    versions.json   one entry per start: packages, Python, machine, commit
    metrics.csv     one row per `log`, one column per metric
    tensorboard/    the same numbers as events
    checkpoints/    see `checkpoint`

A run killed at any moment goes on from its last checkpoint with nothing to clean up by hand, and
its metrics.csv then has the rows that the uninterrupted run would have.
"""

import csv
import json
import math
import os
import pathlib
import sys
from collections.abc import Collection, Mapping
from typing import Any, TextIO

import jax
import tensorboardX

from eihrl_jax import base
from eihrl_jax.config import codec
from eihrl_jax.runs import checkpoint, folders, versions

CHECKPOINTS = "checkpoints"
"""Name of the folder of a run's checkpoints."""

_CONFIG = "config.json"
_METRICS = "metrics.csv"


class RunFolder:
    """A run folder that this process alone writes to; made by `create`, closed by `with`.

    Attributes:
      path: the folder.
    """

    def __init__(self, path: pathlib.Path, lock: int | None):
        """Use `create`."""
        self.path = path
        self._lock = lock
        self._columns: list[str] = []
        self._files: tuple[TextIO, tensorboardX.SummaryWriter] | None = None
        self._first_step = 0

    @classmethod
    def create(
        cls,
        path: pathlib.Path,
        options: Any,
        *,
        resume: bool = False,
        may_change: Collection[str] = (),
    ) -> "RunFolder":
        """Starts a run in a new folder, or goes on in an old one.

        Args:
          path: the folder.
          options: the run's config, a dataclass.
          resume: go on if the folder holds a run; a folder that is absent or empty is started.
          may_change: options that may differ from the run's first start, besides the two that tell
            where the run is and that it goes on.

        Raises:
          UserError: the folder holds something and `resume` is false; it holds no run, or one with
            other options; another process is writing to it.
        """
        if jax.process_index() != 0:
            return cls(path, None)  # The first process looks after the folder for all.
        is_taken = folders.check_free(path, resume=resume)
        if is_taken and not (path / _CONFIG).is_file():
            raise base.UserError(f"{path} holds no run to resume: it has no {_CONFIG}")
        text = codec.to_json(options)
        if is_taken:
            _check_same_options(path / _CONFIG, options, {"run", "resume", *may_change})
        path.mkdir(parents=True, exist_ok=True)
        run = cls(path, folders.take_lock(path))
        folders.write_whole(path / _CONFIG, text)
        starts = _read_starts(path / "versions.json")
        folders.write_whole(
            path / "versions.json", json.dumps([*starts, versions.describe()], indent=2)
        )
        return run

    def __enter__(self) -> "RunFolder":
        """Returns the run folder itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the files and gives the lock back."""
        self.close()

    def close(self) -> None:
        """Closes the files and gives the lock back; may be called twice."""
        for file in self._files or ():
            file.close()
        self._files = None
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def save(self, step: int, state: Any) -> None:
        """Writes a checkpoint; call it after `log` of the same step."""
        checkpoint.save(self.path / CHECKPOINTS, step, state)

    def restore(self, template: Any) -> tuple[int, Any] | None:
        """Reads the last checkpoint and drops the metrics that were logged after it.

        Args:
          template: a state of the same structure, as a fresh start makes it.

        Returns:
          Its step and its state, or None at the beginning of a run.

        Raises:
          UserError: the checkpoint is damaged or holds another structure.
        """
        restored = checkpoint.restore(self.path / CHECKPOINTS, template)
        step = -1 if restored is None else restored[0]
        if jax.process_index() == 0:
            if restored is None and (self.path / _METRICS).is_file():
                print(f"{self.path} has no checkpoint yet: the run begins anew", file=sys.stderr)
            self._columns = _drop_rows_after(self.path / _METRICS, step)
            self._first_step = step + 1
        return restored

    def log(self, step: int, metrics: Mapping[str, Any]) -> None:
        """Appends one row to metrics.csv and the same numbers to TensorBoard.

        Args:
          step: what the run counts in; grows from row to row.
          metrics: scalars by name. A new name adds a column; a name left out leaves an empty field.
        """
        if self._lock is None:
            return
        if self._files is None:
            self._files = self._open()
        table, events = self._files
        values = {name: float(value) for name, value in metrics.items()}
        new = [name for name in values if name not in self._columns]
        if new:
            self._columns += new
            table.close()
            table = _add_columns(self.path / _METRICS, self._columns, len(new))
            self._files = table, events
        row = [step, *(values.get(name, "") for name in self._columns)]
        table.write(",".join(map(str, row)) + "\n")
        for name, value in values.items():
            if math.isfinite(value):
                events.add_scalar(name, value, step)

    def _open(self) -> tuple[TextIO, tensorboardX.SummaryWriter]:
        table = (self.path / _METRICS).open("a", buffering=1)
        return table, _open_events(self.path / "tensorboard", self._first_step)


def _check_same_options(file: pathlib.Path, options: Any, may_change: Collection[str]) -> None:
    """Checks a run's options; those that are newer than the run count as left at their defaults."""
    text = file.read_text()
    try:
        stored = json.loads(text)
    except ValueError:
        raise base.UserError(f"{file} is damaged: no JSON") from None
    new = json.loads(codec.to_json(options))
    if isinstance(stored, dict):
        # What both know comes first: runs of two methods differ in their options, too.
        _check_unchanged(file, _common(new, stored), _common(stored, new), may_change)
    old = codec.from_json(type(options), text, source=str(file))
    _check_unchanged(file, new, json.loads(codec.to_json(old)), may_change)


def _common(options: Any, others: Any) -> Any:
    """Returns those options that are among the others too, nested ones alike."""
    if not (isinstance(options, dict) and isinstance(others, dict)):
        return options
    both = [name for name in options if name in others]
    return {name: _common(options[name], others[name]) for name in both}


def _check_unchanged(file: pathlib.Path, new: Any, old: Any, may_change: Collection[str]) -> None:
    for name, value, old_value in _differences(new, old, ""):
        if name not in may_change:
            started = f"{file.parent} was started with {name} = {old_value!r}"
            raise base.UserError(f"{started} and can't go on with {value!r}")


def _differences(new: Any, old: Any, name: str) -> list[tuple[str, Any, Any]]:
    """Lists (name, new value, old value) of the options that differ, nested ones as a.b."""
    if not (isinstance(new, dict) and isinstance(old, dict)):
        return [] if new == old else [(name, new, old)]
    keys = dict.fromkeys([*new, *old])
    parts = [
        _differences(new.get(key), old.get(key), f"{name}.{key}" if name else key) for key in keys
    ]
    return [difference for part in parts for difference in part]


def _read_starts(file: pathlib.Path) -> list[Any]:
    try:
        return list(json.loads(file.read_text()))
    except (FileNotFoundError, ValueError):
        return []


def _drop_rows_after(file: pathlib.Path, step: int) -> list[str]:
    """Drops rows later than `step` and a last one cut short; returns the columns after `step`."""
    if not file.is_file():
        return []
    lines = [line for line in file.read_text().splitlines(keepends=True) if line.endswith("\n")]
    if not lines:
        return []
    try:
        kept = [line for line in lines[1:] if int(line.partition(",")[0]) <= step]
    except ValueError:
        raise base.UserError(f"{file} is damaged: a row doesn't begin with a number") from None
    if not kept:
        file.unlink()
        return []
    folders.write_whole(file, "".join([lines[0], *kept]))
    return next(csv.reader(lines[:1]))[1:]


def _add_columns(file: pathlib.Path, columns: list[str], num_new: int) -> TextIO:
    """Widens a table, the new fields of its rows being empty, and opens it for further rows."""
    rows = file.read_text().splitlines()[1:]
    header = ",".join(["step", *columns])
    folders.write_whole(file, "\n".join([header, *(row + "," * num_new for row in rows), ""]))
    return file.open("a", buffering=1)


def _open_events(folder: pathlib.Path, first_step: int) -> tensorboardX.SummaryWriter:
    """Opens a new event file; events from `first_step` on in older ones no longer count."""
    folder.mkdir(exist_ok=True)
    before = set(folder.iterdir())
    events = tensorboardX.SummaryWriter(str(folder), purge_step=first_step)
    # tensorboardX puts the machine's name at the end of the file name; a count serves as well.
    for file in set(folder.iterdir()) - before:
        prefix = ".".join(file.name.split(".")[:4])
        file.rename(file.with_name(f"{prefix}.{len(before)}"))
    return events
