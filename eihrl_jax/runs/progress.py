"""What a long job shows: success, steps per second, time left, and how long compiling took."""

import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import rich.console
import rich.progress

PLAIN_INTERVAL = 5.0
"""Seconds between two lines where the output is no terminal."""

_SMOOTHING_SECONDS = 20.0  # long enough for a checkpoint or an evaluation not to show


class Progress:
    """A progress bar on a terminal, and plain lines every few seconds anywhere else.

    Use it with `with`; call `update` as often as is handy.
    """

    def __init__(
        self,
        title: str,
        total: int,
        *,
        unit: str = "steps",
        done: int = 0,
        console: rich.console.Console | None = None,
    ):
        """Prepares a job.

        Args:
          title: what is being done, in a word or two.
          total: number of steps of the whole job.
          unit: what a step is called.
          done: steps that were done earlier, by the run that is resumed.
          console: where to write; by default standard output, for the first process of a run alone.
        """
        self._console = console or rich.console.Console(quiet=jax.process_index() != 0)
        self._title, self._unit, self._total = title, unit, total
        self._done = done
        self._metrics: dict[str, float] = {}
        self._begin = time.monotonic()
        self._history = [(self._begin, done)]
        self._last_line, self._shown = time.monotonic(), -1

        # Elsewhere control codes would fill a log: there lines are printed instead.
        self._bar: rich.progress.Progress | None = None
        if self._console.is_terminal:
            # Brackets in names of files are no styles.
            words, numbers = (
                rich.progress.TextColumn(form, markup=False)
                for form in ("{task.description}", "{task.fields[text]}")
            )
            bar = rich.progress.BarColumn()
            self._bar = rich.progress.Progress(words, bar, numbers, console=self._console)
            self._task = self._bar.add_task(title, total=total, completed=done, text="")

    def __enter__(self) -> "Progress":
        """Shows the bar."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leaves the last state visible."""
        if self._bar is not None:
            self._bar.stop()
        elif self._shown != self._done:  # else the last line already says it
            self._print_line()

    @contextlib.contextmanager
    def compiling(self, what: str) -> Iterator[None]:
        """Prints how long the block took, and leaves it out of the steps per second."""
        self.print(f"{self._title}: compiling {what} ...")
        start = time.monotonic()
        yield
        self.print(f"{self._title}: compiled {what} in {time.monotonic() - start:.1f} s")
        # The clock starts anew, so that compiling doesn't count as slow training.
        self._begin = time.monotonic()
        self._history = [(self._begin, self._done)]

    @contextlib.contextmanager
    def apart(self) -> Iterator[None]:
        """Leaves the time of the block out of the steps per second."""
        start = time.monotonic()
        yield
        took = time.monotonic() - start
        self._begin += took
        self._history = [(moment + took, done) for moment, done in self._history]

    def print(self, line: str) -> None:
        """Prints a line above the bar."""
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def update(self, done: int, metrics: Mapping[str, Any] | None = None) -> None:
        """Tells how far the job is.

        Args:
          done: number of steps done so far, of `total`.
          metrics: what to show beside it; a name `success` is shown in per cent.
        """
        self._done = done
        self._metrics.update({name: float(value) for name, value in (metrics or {}).items()})

        now = time.monotonic()
        # The speed is that of the last seconds: evaluations and checkpoints come in bursts.
        self._history.append((now, done))
        while len(self._history) > 2 and self._history[1][0] < now - _SMOOTHING_SECONDS:
            self._history.pop(0)

        if self._bar is not None:
            self._bar.update(self._task, completed=done, text=self._text())
        elif now - self._last_line >= PLAIN_INTERVAL:
            self._print_line()

    @property
    def seconds(self) -> float:
        """Time since the last compilation, or since the start where nothing was compiled."""
        return time.monotonic() - self._begin

    @property
    def steps_per_second(self) -> float:
        """Speed over the last seconds, compiling left out; 0 where nothing was done yet."""
        (start, first), (end, last) = self._history[0], self._history[-1]
        return (last - first) / (end - start) if last > first and end > start else 0.0

    def _print_line(self) -> None:
        self._last_line, self._shown = time.monotonic(), self._done
        percent = 100 * self._done / max(self._total, 1)
        self.print(f"{self._title}: {percent:.0f} % | {self._text()}")

    def _text(self) -> str:
        parts = [f"{self._done:,}/{self._total:,} {self._unit}"]
        parts += [_metric(name, value) for name, value in self._metrics.items()]
        speed = self.steps_per_second
        if speed > 0:
            left = max(self._total - self._done, 0) / speed
            parts += [f"{_short(speed)} {self._unit}/s", f"{format_seconds(left)} left"]
        return " | ".join(parts)


def format_seconds(seconds: float) -> str:
    """Returns a duration as people say it.

    >>> format_seconds(42.3), format_seconds(95), format_seconds(7260)
    ('42 s', '1 min 35 s', '2 h 01 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _metric(name: str, value: float) -> str:
    return f"{name} {100 * value:.1f} %" if name == "success" else f"{name} {value:.3g}"


def _short(number: float) -> str:
    return f"{number:,.0f}" if number >= 10 else f"{number:.2g}"
