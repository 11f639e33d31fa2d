"""Arrays of a pytree on disk. The only module that knows Orbax.

Arrays are stored without compression: replay buffers hardly compress, and saving 230 MB takes
0.3 to 1.2 s so, against 0.8 to 1.8 s with it (two cores).
"""

import contextlib
import errno
import gc
import io
import logging
import os
import pathlib
import re
import shutil
import tempfile
import textwrap
import time
from collections.abc import Iterator
from typing import TypeVar

import jax
import orbax.checkpoint as ocp
import tensorstore
from jaxtyping import PyTree

from eihrl_jax import base
from eihrl_jax.runs import stopping

FOLDER = "arrays"
"""Name of the folder that Orbax writes."""

_SECONDS_OF_COMPLAINTS = 0.3
_MISREAD = re.compile(r"[\[\]\\\udc80-\udcff]|:/")
"""What Orbax takes for a pattern, an escape or an address in a path, or can't take: no Unicode."""

_UNREADABLE = (ValueError, TypeError, LookupError, AttributeError, RuntimeError, MemoryError)
"""What Orbax raises where checksums are right and the files make no sense all the same."""

LeafT = TypeVar("LeafT")


def write(folder: pathlib.Path, tree: PyTree) -> None:
    """Writes a tree into `folder/arrays`; of several processes all must call it.

    Args:
      folder: is there; where the system refuses, it is removed.
      tree: pytree of arrays, typed keys and numbers.

    Raises:
      OSError: the system refuses, say because the disk is full; the error has the name of the
        folder above.
    """
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(tree) if isinstance(leaf, jax.Array))
    refused = None
    if shutil.disk_usage(folder).free < size:
        refused = _refused(errno.ENOSPC, folder)
    else:
        # Of its many threads and tasks each would print why it has failed, some a little later.
        with _unheard(), contextlib.redirect_stderr(io.StringIO()):
            try:
                # Its threads would go on, and complain, for a while after Ctrl-C.
                with stopping.held_back(), _plain(folder) as plain, _checkpointer() as checkpointer:
                    checkpointer.save(plain / FOLDER, tree)
            except (OSError, ValueError) as error:
                refused = _refusal(error, folder)
                if refused is None:
                    raise
            if refused is not None:
                gc.collect()
                time.sleep(_SECONDS_OF_COMPLAINTS)
    if refused is not None:
        shutil.rmtree(folder, ignore_errors=True)
        raise refused

    # Orbax notes the folder it wrote to; arrays are given away without their origin.
    (folder / FOLDER / "commit_success.txt").unlink(missing_ok=True)


def read(folder: pathlib.Path, template: PyTree) -> PyTree:
    """Reads what `write` wrote, into the structure, types and places of a template.

    Raises:
      base.UserError: it makes no sense, or holds other arrays than the template.
    """
    # Without arguments Orbax would ask for the devices that the arrays were saved from.
    template = jax.tree.map(_placed, template)
    restore_args = ocp.checkpoint_utils.construct_restore_args(template)
    arguments = ocp.args.PyTreeRestore(item=template, restore_args=restore_args)
    with _unheard(), _checkpointer() as checkpointer, _plain(folder) as plain:
        try:
            return checkpointer.restore(plain / FOLDER, args=arguments)
        except _UNREADABLE as error:
            reason = textwrap.shorten(f"{type(error).__name__}: {error}", 120)

    # Tasks that were still waiting would each print that they can't go on.
    with contextlib.redirect_stderr(io.StringIO()):
        gc.collect()
    raise base.UserError(f"{folder} holds arrays that can't be read: {reason}")


def wait_for_all(name: str) -> None:
    """Waits until all processes that train together have come here."""
    ocp.multihost.sync_global_processes(name)


@contextlib.contextmanager
def _checkpointer() -> Iterator[ocp.Checkpointer]:
    # Orbax asks TensorStore for figures to log them, and 0.1.86 never frees those it has told.
    collect = tensorstore.experimental_collect_matching_metrics
    tensorstore.experimental_collect_matching_metrics = lambda *_: []
    try:
        handler = ocp.PyTreeCheckpointHandler(use_zarr3=True, use_compression=False)
        with ocp.Checkpointer(handler) as checkpointer:
            yield checkpointer
    finally:
        tensorstore.experimental_collect_matching_metrics = collect


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Keeps what Orbax uses from logging."""
    loggers = [logging.getLogger(name) for name in ("absl", "asyncio")]
    were_disabled = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, was_disabled in zip(loggers, were_disabled, strict=True):
            logger.disabled = was_disabled


def _refusal(error: Exception, folder: pathlib.Path) -> OSError | None:
    """Returns what the system has refused, None where an error is none of its own."""
    # Orbax's storage raises errors of values, with the system's number in the text.
    found = re.search(r"os_error_code='(\d+)'", str(error))
    number = error.errno if isinstance(error, OSError) else found and int(found[1])
    if not number and "RESOURCE_EXHAUSTED" in str(error):
        number = errno.ENOSPC
    return _refused(number, folder) if number else None


def _refused(number: int, folder: pathlib.Path) -> OSError:
    return OSError(number, os.strerror(number), str(folder.parent))


@contextlib.contextmanager
def _plain(folder: pathlib.Path) -> Iterator[pathlib.Path]:
    """Gives a folder a path that Orbax takes as it is: a link's, where its own would be misread."""
    path = folder.absolute()
    if not _MISREAD.search(str(path)):
        yield path
        return

    with tempfile.TemporaryDirectory() as place:
        link = pathlib.Path(place) / "folder"
        link.symlink_to(path, target_is_directory=True)
        yield link


def _placed(leaf: LeafT) -> LeafT | jax.ShapeDtypeStruct:
    """Gives an abstract array a place: that of the one that was saved may not exist here."""
    if not isinstance(leaf, jax.ShapeDtypeStruct) or leaf.sharding is not None:
        return leaf
    return leaf.update(sharding=jax.sharding.SingleDeviceSharding(jax.devices()[0]))
