"""Ctrl-C: while a run trains, the current piece of work is finished and saved first."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

_NOTICE = b"\nstopping as soon as this piece is done and kept; Ctrl-C again stops at once\n"


class Stop:
    """Whether the user has pressed Ctrl-C.

    Attributes:
      is_asked: set by the first Ctrl-C.
    """

    def __init__(self) -> None:
        """Starts without a request."""
        self.is_asked = False


@contextlib.contextmanager
def deferred() -> Iterator[Stop]:
    """Turns the first Ctrl-C in the block into a flag, which the block checks when it can.

    The second one interrupts as usual. Outside of the main thread, and where a process ignores
    Ctrl-C, nothing changes.
    """
    stop = Stop()
    before = signal.getsignal(signal.SIGINT)
    if not _can_be_asked():
        yield stop
        return

    def ask(number: int, frame: FrameType | None) -> None:
        del number, frame
        stop.is_asked = True
        signal.signal(signal.SIGINT, before)
        # Past Python's buffers: the signal may have come while one of them is being written.
        os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, _NOTICE)

    signal.signal(signal.SIGINT, ask)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Delays Ctrl-C until the end of the block, which must be short and not be interrupted.

    Outside of the main thread, and where a process ignores Ctrl-C, nothing changes.
    """
    if not _can_be_asked():
        yield
        return

    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


def _can_be_asked() -> bool:
    """Returns whether this thread receives Ctrl-C, and the current handler is one of Python's."""
    is_main = threading.current_thread() is threading.main_thread()
    # A shell starts what runs in its background with Ctrl-C ignored.
    return is_main and signal.getsignal(signal.SIGINT) not in (None, signal.SIG_IGN)


def not_lost() -> None:
    """Lets Ctrl-C interrupt the process even where it comes in a callback of the collector.

    JAX has such a callback, which runs whenever Python collects garbage. An exception in it is
    printed as one that is ignored, and ignored. Who has a hook of his own for these keeps it.
    """
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook = _interrupt_again


def _interrupt_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Interrupts the main thread soon, when the collector has gone back to what that was at."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    main = threading.main_thread().ident
    assert main is not None
    timer = threading.Timer(0.05, signal.pthread_kill, [main, signal.SIGINT])
    timer.daemon = True
    timer.start()
