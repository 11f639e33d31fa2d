"""Datasets in Minari's format: by id, in the folder of all datasets."""

import contextlib
import os
import pathlib
import warnings
from collections.abc import Iterable, Iterator
from typing import Any

import gymnasium
import minari  # pyright: ignore[reportMissingImports]
from minari import namespace as namespaces  # pyright: ignore[reportMissingImports]
from minari.dataset import minari_dataset  # pyright: ignore[reportMissingImports]

from eihrl_jax import base
from eihrl_jax.datasets import parts
from eihrl_jax.storage import writing

_ROOT = "MINARI_DATASETS_PATH"
_EXTRA = 2**13  # bytes that HDF5 takes for an array beside its numbers, and some for its folder


def check_name(name: str) -> None:
    """Checks an id.

    Raises:
      base.UserError: it isn't as it must be.
    """
    try:
        minari_dataset.parse_dataset_id(name)
    except (ValueError, TypeError):
        raise base.UserError(
            f"name = {name!r} must be like eihrl_jax/ant-u/walking-v0: letters, digits, - and _, "
            "and a version at the end"
        ) from None


def folder_of(name: str, root: pathlib.Path | None) -> pathlib.Path:
    """Returns where a dataset lies: in the folder of all that is given, or in Minari's own."""
    with _rooted(root):
        return minari.storage.get_dataset_path(name)


def write(
    name: str,
    root: pathlib.Path,
    env: gymnasium.Env,
    files: Iterable[pathlib.Path],
    first_seed: int,
    num_episodes: int,
    **metadata: Any,
) -> None:
    """Joins parts to a dataset.

    Args:
      name: its id.
      root: folder of datasets, in which it isn't there yet.
      env: whose episodes they are.
      files: the parts, in their order.
      first_seed: seed of the first episode; that of the next is by 1 greater.
      num_episodes: how many of the parts' episodes it is to have.
      metadata: what else Minari is to know of it.

    Raises:
      base.UserError: a part is damaged.
      OSError: it can't be written, say because the disk is full.
    """
    done, size, dataset = 0, 0, None
    with _rooted(root), warnings.catch_warnings():
        # Minari misses an author, a link to code, and an expert's return.
        warnings.simplefilter("ignore", UserWarning)
        for file in files:
            rows = list(parts.read(file, first_seed + done))[: num_episodes - done]
            # HDF5 ends the process where it finds the disk full.
            size += sum(_EXTRA + array.nbytes for each in rows for array in each.values())
            there = sum(path.stat().st_size for path in root.rglob("*.hdf5"))
            writing.check_room(root, size, min(there, size))
            buffer = [_buffer(each, first_seed + done + i) for i, each in enumerate(rows)]
            done += len(buffer)
            if dataset is None:
                dataset = minari.create_dataset_from_buffers(
                    dataset_id=name, buffer=buffer, env=env, **metadata
                )
            else:
                dataset.update_dataset_from_buffer(buffer)


def make_namespace(name: str, root: pathlib.Path | None) -> None:
    """Makes what a dataset's id begins with known to Minari."""
    namespace, _, _ = minari_dataset.parse_dataset_id(name)
    with _rooted(root):
        if namespace is not None and namespace not in namespaces.list_local_namespaces():
            namespaces.create_namespace(namespace)


def _buffer(row: parts.Arrays, seed: int) -> minari.data_collector.EpisodeBuffer:
    """Converts an episode to Minari's type."""
    return minari.data_collector.EpisodeBuffer(seed=seed, **parts.nested(row))


@contextlib.contextmanager
def _rooted(root: pathlib.Path | None) -> Iterator[None]:
    """Lets Minari's datasets lie in a folder; None: where they are."""
    before = os.environ.get(_ROOT)
    if root is not None:
        os.environ[_ROOT] = str(root)
    try:
        yield
    finally:
        if root is not None:
            os.environ.pop(_ROOT)
            if before is not None:
                os.environ[_ROOT] = before
