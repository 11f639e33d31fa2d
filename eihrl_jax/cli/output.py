"""Standard output whose reader may go before a command is through."""

import functools
import io
import os
import sys
from collections.abc import Callable
from typing import ParamSpec

P = ParamSpec("P")


class _Output(io.TextIOWrapper):
    """Standard output that is left alone when its reader goes, as in `eihrl evaluate | head`.

    What computes goes on, and its results are written; the rest of its output goes nowhere.
    """

    is_read = True

    def write(self, text: str) -> int:
        """Writes a text, as long as somebody reads."""
        try:
            return super().write(text)
        except BrokenPipeError:
            self._go_on()
            return len(text)

    def flush(self) -> None:
        """Hands on what is written, as long as somebody reads."""
        try:
            super().flush()
        except BrokenPipeError:
            self._go_on()

    def _go_on(self) -> None:
        """Sends to nowhere what is still to be written, what is held back included."""
        self.is_read = False
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def outlives_its_reader(call: Callable[P, None]) -> Callable[P, None]:
    """Lets a command end as it does when nobody reads its output any more, but for its code."""

    @functools.wraps(call)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> None:
        if sys.stdout is not sys.__stdout__ or sys.stdout is None:
            return call(*args, **kwargs)  # it has been replaced already: there is no pipe
        old = sys.stdout
        sys.stdout = output = _Output(
            old.buffer, encoding=old.encoding, errors=old.errors, line_buffering=old.isatty()
        )
        try:
            call(*args, **kwargs)
        finally:
            output.flush()
            if not output.is_read:
                sys.exit(141)  # 128 + SIGPIPE, as shells have it

    return wrapped
