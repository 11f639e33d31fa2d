"""The numbers of one run, row by row: metrics.csv, and the same as events for TensorBoard."""

import csv
import io
import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import SupportsFloat, TextIO

import tensorboardX

from eihrl_jax import base
from eihrl_jax.storage import reading, writing

FILE = "metrics.csv"
"""Name of the table in a run's folder: one row per `log`, one column per metric."""

_EVENTS = "tensorboard"


class MetricsLog:
    """The metrics of a run folder; files are opened by the first row, and closed by `close`."""

    def __init__(self, folder: pathlib.Path):
        """Begins a log, or goes on with what the folder holds once `rewind` has been called."""
        self._folder = folder
        self._columns: list[str] = []
        self._first_step = 0
        self._table: TextIO | None = None
        self._events: tensorboardX.SummaryWriter | None = None

    def rewind(self, step: int) -> None:
        """Drops all that was logged after a step, and a last row that a kill cut short.

        Raises:
          UserError: the table is damaged.
        """
        self._columns = _drop_rows_after(self._folder / FILE, step)
        self._first_step = step + 1  # TensorBoard drops what older files have from here on

    def log(self, step: int, metrics: Mapping[str, SupportsFloat]) -> None:
        """Appends one row, which is on disk when this returns.

        Args:
          step: what the run counts in; grows from row to row.
          metrics: scalars by name. A new name adds a column; a name left out leaves an empty field.
        """
        values = {name: float(value) for name, value in metrics.items()}

        # A metric that is first measured later, such as an evaluation's, widens the table.
        new = [name for name in values if name not in self._columns]
        if new:
            self._columns += new
            self._close_table()
            _widen(self._folder / FILE, ["step", *self._columns])

        if self._table is None:
            # Line by line, so that a kill costs the row that is being written at most.
            file = writing.append(self._folder / FILE)
            self._table = io.TextIOWrapper(file, "utf-8", newline="", line_buffering=True)
        row = [step, *(values.get(name, "") for name in self._columns)]
        csv.writer(self._table, lineterminator="\n").writerow(row)

        if self._events is None:
            self._events = _open_events(self._folder / _EVENTS, self._first_step)
        for name, value in values.items():
            if math.isfinite(value):  # TensorBoard draws no curve through a nan
                self._events.add_scalar(name, value, step)

    def close(self) -> None:
        """Closes the files; may be called twice."""
        self._close_table()
        if self._events is not None:
            self._events.close()
            self._events = None

    def _close_table(self) -> None:
        if self._table is not None:
            self._table.close()
            self._table = None


def _drop_rows_after(file: pathlib.Path, step: int) -> list[str]:
    """Drops rows later than `step` and a last one cut short; returns the columns after `step`."""
    if not file.is_file():
        return []
    # A kill can only have cut the last line, as rows are appended one by one.
    lines = reading.read_text(file).splitlines(keepends=True)
    complete = [line for line in lines if line.endswith("\n")]
    header, *rows = csv.reader(complete) if complete else [[]]
    try:
        kept = [row for row in rows if int(row[0]) <= step]
    except (ValueError, IndexError):
        raise base.UserError(f"{file} is damaged: a row doesn't begin with a number") from None

    # Without rows there are no columns either: those that remain come in the order of their rows.
    if not kept:
        file.unlink()
        return []
    _write(file, [header, *kept])
    return header[1:]


def _widen(file: pathlib.Path, header: Sequence[str]) -> None:
    """Gives a table more columns, whose fields are empty in the rows that are there."""
    rows = list(csv.reader(reading.read_text(file).splitlines()))[1:] if file.is_file() else []
    _write(file, [header, *([*row, *[""] * (len(header) - len(row))] for row in rows)])


def _write(file: pathlib.Path, rows: Sequence[Sequence[str]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    writing.write_text(file, text.getvalue())


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
