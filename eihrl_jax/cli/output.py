"""Standard output that survives a closed pipe and a full disk."""

import codecs
import functools
import io
import os
import signal
import sys
from collections.abc import Callable
from typing import ParamSpec

P = ParamSpec("P")

INTERRUPTED = 128 + signal.SIGINT
"""Exit code after Ctrl-C, as shells have it."""


class _Output(io.TextIOWrapper):
    """Standard output that is discarded once its reader has gone, as in `eihrl evaluate | head`.

    The command goes on and writes its results. Characters that the encoding lacks are replaced by
    similar ones.
    """

    end: OSError | None = None

    def write(self, text: str) -> int:
        """Writes a text, or discards it after an error."""
        try:
            return super().write(text)
        except OSError as error:
            self._go_on(error)
            return len(text)

    def flush(self) -> None:
        """Flushes the buffer, or discards it after an error."""
        try:
            super().flush()
        except OSError as error:
            self._go_on(error)

    def _go_on(self, error: OSError) -> None:
        """Discards all further output, including what is buffered."""
        self.end = error
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def outlives_its_reader(call: Callable[P, None]) -> Callable[P, None]:
    """Lets a command run to its end when its output can't be written; its exit code tells."""

    @functools.wraps(call)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> None:
        if sys.stdout is not sys.__stdout__ or sys.stdout is None:
            return call(*args, **kwargs)  # it has been replaced already: there is no pipe
        old = sys.stdout
        codecs.register_error(_LIKE, _like)
        sys.stdout = output = _Output(
            old.buffer, encoding=old.encoding, errors=_LIKE, line_buffering=old.isatty()
        )
        try:
            call(*args, **kwargs)
        except (KeyboardInterrupt, SystemExit) as end:
            is_interrupt = isinstance(end, KeyboardInterrupt)  # while a command is still imported
            if not is_interrupt and end.code != INTERRUPTED:
                raise
            # Ignored from here on: another Ctrl-C would only print a traceback of the shutdown.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            if is_interrupt:
                print("interrupted", file=sys.stderr)
            sys.exit(INTERRUPTED)
        finally:
            output.flush()
            if isinstance(output.end, BrokenPipeError):
                sys.exit(141)  # 128 + SIGPIPE, as shells have it
            if output.end is not None:
                print(f"error: standard output: {output.end.strerror}", file=sys.stderr)
                sys.exit(2)

    return wrapped


_LIKE = "eihrl_jax.like"
_ALIKE = {"±": "+-", "…": "...", "·": "-", "≥": ">=", "≤": "<="}


def _like(error: UnicodeError) -> tuple[str | bytes, int]:
    """Replaces characters that an encoding lacks by similar ones, or by their escape sequence."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    like = (_ALIKE.get(letter, letter) for letter in letters)
    return "".join(like).encode("ascii", "backslashreplace").decode("ascii"), error.end
