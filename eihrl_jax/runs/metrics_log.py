"""The numbers of one run, row by row: metrics.csv, and the same as events for TensorBoard."""

import csv
import hashlib
import io
import math
import pathlib
import time
from collections.abc import Mapping, Sequence
from typing import SupportsFloat

from google.protobuf.message import Message
from tensorboardX import event_file_writer, summary
from tensorboardX.proto import event_pb2

from eihrl_jax import base
from eihrl_jax.storage import reading, writing

FILE = "metrics.csv"
"""Name of the table in a run's folder: one row per `log`, one column per metric."""

_EVENTS = "tensorboard"

# Made when they are imported.
_Event = event_pb2.Event  # pyright: ignore[reportAttributeAccessIssue]
_SessionLog = event_pb2.SessionLog  # pyright: ignore[reportAttributeAccessIssue]


class MetricsLog:
    """The metrics of a run folder; events are opened by the first row, and closed by `close`."""

    def __init__(self, folder: pathlib.Path):
        """Begins a log, or goes on with what the folder holds once `rewind` has been called."""
        self._folder = folder
        self._columns: list[str] = []
        self._first_step = 0
        self._sum = hashlib.sha256()
        self._events: event_file_writer.EventsWriter | None = None

    @property
    def checksum(self) -> str:
        """Changes with any number that has been logged so far."""
        return self._sum.hexdigest()[:16]

    def rewind(self, step: int, checksum: str | None = None) -> None:
        """Drops all that was logged after a step, and a last row that a kill cut short.

        Args:
          step: the last one that remains.
          checksum: as it was after that step; None: unknown.

        Raises:
          UserError: the table is damaged; it is left as it is.
        """
        file = self._folder / FILE
        header, rows = _rows_until(file, step)
        for row in rows:
            values = zip(header[1:], row[1:], strict=False)
            self._count(row[0], {name: text for name, text in values if text})
        if checksum is not None and checksum != self.checksum:
            raise base.UserError(f"{file} isn't what the run has logged up to step {step}")

        # Without rows there are no columns either: those that remain come in the order of rows.
        if rows:
            _write(file, [header, *rows])
        else:
            file.unlink(missing_ok=True)
        self._columns = header[1:] if rows else []
        self._first_step = step + 1  # TensorBoard drops what older files have from here on

    def log(self, step: int, metrics: Mapping[str, SupportsFloat]) -> None:
        """Appends one row, which is on disk when this returns.

        Args:
          step: what the run counts in; grows from row to row.
          metrics: scalars by name. A new name adds a column; a name left out, or without a value
            (NaN), leaves an empty field.

        Raises:
          OSError: it can't be written; the error has the file's name.
        """
        values = {name: float(value) for name, value in metrics.items()}
        values = {name: value for name, value in values.items() if not math.isnan(value)}

        # A metric that is first measured later, such as an evaluation's, widens the table.
        new = [name for name in values if name not in self._columns]
        if new:
            self._columns += new
            _widen(self._folder / FILE, ["step", *self._columns])

        # Line by line, so that a kill costs the row that is being written at most.
        row = [step, *(values.get(name, "") for name in self._columns)]
        writing.append(self._folder / FILE, _as_csv([row]))
        self._count(str(step), {name: str(value) for name, value in values.items()})

        with writing.named(self._folder / _EVENTS):
            if self._events is None:
                self._events = _open_events(self._folder / _EVENTS, self._first_step)
            for name, value in values.items():
                if math.isfinite(value):  # TensorBoard draws no curve through infinity
                    scalar = summary.scalar(name, value)
                    self._events.write_event(_event(step, summary=scalar))
            self._events.flush()

    def _count(self, step: str, texts: Mapping[str, str]) -> None:
        """Adds a row to the checksum, the same in a table that has got more columns since."""
        self._sum.update(repr((step, sorted(texts.items()))).encode())

    def close(self) -> None:
        """Closes the files; may be called twice."""
        if self._events is not None:
            events, self._events = self._events, None
            with writing.named(self._folder / _EVENTS):
                events.close()


def _rows_until(file: pathlib.Path, step: int) -> tuple[list[str], list[list[str]]]:
    """Returns the header and the rows up to a step, without a last one that was cut short."""
    if not file.is_file():
        return [], []
    # A kill can only have cut the last line, as rows are appended one by one.
    lines = reading.read_text(file).splitlines(keepends=True)
    complete = [line for line in lines if line.endswith("\n")]
    try:
        header, *rows = csv.reader(complete) if complete else [[]]
        return header, [row for row in rows if int(row[0]) <= step]
    except (ValueError, IndexError, csv.Error):
        raise base.UserError(f"{file} is damaged: a row doesn't begin with a number") from None


def _widen(file: pathlib.Path, header: Sequence[str]) -> None:
    """Gives a table more columns, whose fields are empty in the rows that are there."""
    rows = list(csv.reader(reading.read_text(file).splitlines()))[1:] if file.is_file() else []
    _write(file, [header, *([*row, *[""] * (len(header) - len(row))] for row in rows)])


def _write(file: pathlib.Path, rows: Sequence[Sequence[object]]) -> None:
    writing.write_text(file, _as_csv(rows))


def _as_csv(rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _event(step: int, **content: Message) -> Message:
    """Returns an event of this moment."""
    return _Event(wall_time=time.time(), step=step, **content)


def _open_events(folder: pathlib.Path, first_step: int) -> event_file_writer.EventsWriter:
    """Opens a new event file; events from `first_step` on in older ones no longer count."""
    folder.mkdir(exist_ok=True)
    before = set(folder.iterdir())
    # Not the package's own writer, whose thread would die of a full disk and keep its queue.
    events = event_file_writer.EventsWriter(str(folder / "events"))
    start = _SessionLog(status=_SessionLog.START)
    events.write_event(_event(first_step, session_log=start))
    # tensorboardX puts the machine's name at the end of the file name; a count serves as well.
    for file in set(folder.iterdir()) - before:
        prefix = ".".join(file.name.split(".")[:4])
        file.rename(file.with_name(f"{prefix}.{len(before)}"))
    return events
