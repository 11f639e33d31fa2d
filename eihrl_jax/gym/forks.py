"""Detects processes that were forked while JAX was running, in which it would hang."""

import os
import threading

from eihrl_jax import base

_is_stuck = threading.Event()  # set in a process in which JAX would hang


def watch() -> None:
    """Makes processes that are forked from now on know whether JAX was running then."""
    if hasattr(os, "register_at_fork"):  # not on Windows, which forks nothing
        os.register_at_fork(after_in_child=_note)


def _note() -> None:
    """Notes in a forked process whether JAX was running."""
    # JAX has no public name for it.
    from jax._src import xla_bridge

    if xla_bridge.backends_are_initialized():
        _is_stuck.set()


def check() -> None:
    """Checks that JAX wouldn't hang, as in a forked process that lacks its threads.

    Raises:
      base.UserError: it would.
    """
    if _is_stuck.is_set():
        raise base.UserError(
            "this process was forked from one in which JAX was running, and would hang: make it "
            "with context='spawn' or 'forkserver', or before JAX is used"
        )
