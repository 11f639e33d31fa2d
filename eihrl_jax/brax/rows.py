"""Runs Brax's learners row by row: each runs in a thread that is paused between two rows."""

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

RowT = TypeVar("RowT")


class _Closed(Exception):
    """Raised in the thread to end it: no more rows are wanted."""


class Rows(Generic[RowT]):
    """The values that a function passes to its callback, one at a time; it pauses in between.

    The function runs in a thread of its own, but never at the same time as who asks.
    """

    def __init__(self, work: Callable[[Callable[[RowT], None]], None]):
        """Takes the function, which is called with its callback at the first `next`."""
        self._work = work
        self._told: queue.SimpleQueue[RowT | BaseException] = queue.SimpleQueue()
        self._asked = threading.Semaphore(0)
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="brax", daemon=True)

    def next(self) -> RowT:
        """Returns the next value.

        Raises:
          StopIteration: there is none, and the function has returned.
          BaseException: whatever the function raised.
        """
        if self._thread.ident is None:
            self._thread.start()
        self._asked.release()
        told = self._told.get()
        if isinstance(told, BaseException):
            raise told
        return told

    def close(self) -> None:
        """Ends the function where it is paused, if it has begun; may be called twice."""
        self._is_closed = True
        self._asked.release()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            self._wait()
            self._work(self._tell)
            self._told.put(StopIteration())
        except _Closed:
            pass
        except BaseException as error:  # whatever it is, it belongs to who asks
            self._told.put(error)

    def _tell(self, row: RowT) -> None:
        """Passes on a row, and pauses."""
        self._told.put(row)
        self._wait()

    def _wait(self) -> None:
        self._asked.acquire()
        if self._is_closed:
            raise _Closed
