"""Checkpoints: pytrees on disk, written atomically.

A tree is stored as a folder `arrays/`, see `arrays`, beside a `manifest.json` with every array's
shape and type and every file's checksum. It is written under a hidden name and renamed when it is
complete: so a process killed at any moment leaves the last complete checkpoint, and the next save
removes the incomplete one. Nothing is ever unpickled.
"""

import hashlib
import json
import math
import pathlib
import shutil
from collections.abc import Mapping
from typing import Any, TypeVar, overload

import jax
import numpy as np
from jaxtyping import PyTree

from eihrl_jax import base
from eihrl_jax.runs import arrays
from eihrl_jax.storage import reading, writing

KEEP = 2
"""Checkpoints kept in a run folder."""

MAX_SIZE = 2**30
"""Most bytes of all arrays together, if a tree is read without a template."""

_HIDDEN = writing.TEMPORARY  # not a digit, so `_steps` ignores such folders
_FORMAT = 1  # of the manifest; counts up when an older reader would misread it
_MANIFEST = "manifest.json"

TreeT = TypeVar("TreeT")


class StructureError(base.UserError):
    """A folder is undamaged, but its arrays aren't those of the template."""


def save(folder: pathlib.Path, step: int, state: PyTree, *, keep: int = KEEP) -> pathlib.Path:
    """Writes a checkpoint, synchronously, then removes all but the last `keep`.

    If the step exists already, it isn't written again: a run has one state per step.

    Args:
      folder: the run's folder of checkpoints; created if it doesn't exist.
      step: must increase from checkpoint to checkpoint.
      state: pytree of arrays, typed keys and numbers.
      keep: how many checkpoints remain.

    Returns:
      The folder of this checkpoint.
    """
    path = folder / f"{step:012d}"
    if not path.exists():
        write(path, state)
    # Older ones are removed only when the new one is complete.
    if jax.process_index() == 0:
        _clean(folder)
        for old in _steps(folder)[:-keep]:
            _remove(folder / f"{old:012d}")
    return path


def last_step(folder: pathlib.Path) -> int | None:
    """Returns the step of a run's last complete checkpoint, or None if there is none."""
    return max(_steps(folder), default=None)


def restore(folder: pathlib.Path, template: TreeT) -> tuple[int, TreeT] | None:
    """Reads the last complete checkpoint of a run.

    Args:
      folder: the run's folder of checkpoints.
      template: an initial state of the run, which gives structure, types and placement. If it has
        only shapes, arrays go to the default device.

    Returns:
      The checkpoint's step and state, or None if there is no complete one.

    Raises:
      UserError: the checkpoint is damaged or has another structure.
    """
    steps = _steps(folder)
    if not steps:
        return None

    try:
        return steps[-1], read(folder / f"{steps[-1]:012d}", template)
    except StructureError as error:
        # Older checkpoints of the run have the same structure, so there is none to go back to.
        origin = "it comes from other options or from another version of eihrl_jax"
        raise base.UserError(f"{error}; {origin}") from None
    except base.UserError as error:
        if len(steps) == 1:
            raise
        before = f"without that folder, the run goes on from step {steps[-2]}"
        raise base.UserError(f"{error}; {before}") from None


def write(
    path: pathlib.Path,
    tree: PyTree,
    *,
    files: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> None:
    """Writes one tree to a new folder, which appears only when it is complete.

    Where several processes train together, all must call this: Orbax writes the arrays from all of
    them, the first process writes the rest.

    Args:
      path: the folder.
      tree: pytree of arrays, typed keys and numbers.
      files: further text files by name, also covered by checksums.
      overwrite: replace an existing folder, if this function wrote it.

    Raises:
      UserError: the path exists already.
      OSError: it can't be written; incomplete files are removed.
    """
    hidden = path.parent / f"{_HIDDEN}{path.name}"
    if jax.process_index() == 0:
        # Only what this module wrote is ever removed, never a user's folder.
        if overwrite and is_complete(path):
            _remove(path)
        if path.exists():
            raise base.UserError(f"{path} exists already and is not overwritten")
        path.parent.mkdir(parents=True, exist_ok=True)
        _clean(path.parent)

        hidden.mkdir()

    arrays.wait_for_all("checkpoint: prepared")
    arrays.write(hidden, tree)

    if jax.process_index() == 0:
        for name, text in (files or {}).items():
            writing.write_text(hidden / name, text)
        checksums = {name: _checksum(file) for name, file in _files(hidden).items()}
        manifest = {"format": _FORMAT, "arrays": describe(tree), "files": checksums}
        writing.write_text(hidden / _MANIFEST, json.dumps(manifest, indent=1))
        # Atomic: from here on the checkpoint exists.
        hidden.rename(path)
    arrays.wait_for_all("checkpoint: complete")


@overload
def read(path: pathlib.Path) -> PyTree: ...
@overload
def read(path: pathlib.Path, template: TreeT) -> TreeT: ...
def read(path: pathlib.Path, template: PyTree = None) -> PyTree:
    """Reads a tree that `write` wrote, after verifying all checksums.

    Args:
      path: the folder.
      template: a tree of the same structure, of arrays or their shapes. Arrays are placed as in the
        template, or on the default device if it doesn't say where. None: nested dicts of arrays
        are returned.

    Raises:
      StructureError: the arrays aren't those of the template.
      UserError: it is damaged, or larger than `MAX_SIZE` without template.
    """
    # Before Orbax reads anything, so that the message names the damaged file.
    manifest = _manifest(path)
    _check_files(path, manifest["files"])
    if template is None:
        template = _nested(manifest["arrays"], path)
        _check_size(template, path)
    _check_kinds(path, manifest["arrays"], describe(template))

    return arrays.read(path, template)


def read_file(path: pathlib.Path, name: str) -> str:
    """Reads a text file that `write` put beside the arrays, after verifying its checksum.

    Raises:
      UserError: it doesn't exist, or is damaged.
    """
    files = _manifest(path)["files"]
    if name not in files:
        raise base.UserError(f"{path} has no {name}")
    _check_file(path, name, files[name], _files(path))
    return reading.read_text(path / name)


def is_complete(path: pathlib.Path) -> bool:
    """Returns whether `write` wrote this folder."""
    return (path / _MANIFEST).is_file()


def describe(tree: PyTree) -> dict[str, str]:
    """Returns type and shape of every leaf of a tree, by the leaf's path.

    >>> describe({"actor": {"bias": np.zeros(3, np.float32)}})
    {'actor/bias': 'float32[3]'}
    """
    leaves = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {jax.tree_util.keystr(key, simple=True, separator="/"): _kind(x) for key, x in leaves}


def _kind(leaf: jax.typing.ArrayLike | jax.ShapeDtypeStruct) -> str:
    """Returns type and shape, such as "float32[3]"."""
    # JAX arrays aren't converted, since typed keys can't be.
    is_array = isinstance(leaf, jax.Array | jax.ShapeDtypeStruct | np.ndarray)
    array = leaf if is_array else np.asarray(leaf)
    return f"{array.dtype}[{','.join(map(str, array.shape))}]"


def _steps(folder: pathlib.Path) -> list[int]:
    """Returns the steps of the complete checkpoints, ascending."""
    return sorted(int(path.name) for path in folder.glob("[0-9]*") if path.name.isdecimal())


def _remove(path: pathlib.Path) -> None:
    """Removes a checkpoint; one half removed by a killed process has no valid name any more."""
    hidden = path.parent / f"{_HIDDEN}removed-{path.name}"
    path.rename(hidden)
    shutil.rmtree(hidden)


def _clean(folder: pathlib.Path) -> None:
    """Removes the leftovers of killed saves and removals."""
    for leftover in folder.glob(f"{_HIDDEN}*"):
        writing.discard(leftover)


def _files(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    """Returns all files below a folder by their path in it."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path for path in paths}


def _checksum(path: pathlib.Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _manifest(path: pathlib.Path) -> dict[str, Any]:  # JSON
    """Reads a folder's manifest.

    Raises:
      UserError: it is missing, damaged, or of another format.
    """
    if not is_complete(path):
        raise base.UserError(f"{path} is no checkpoint: it has no {_MANIFEST}")

    try:
        manifest = reading.read_json(path / _MANIFEST)
        version = manifest["format"]
        # A truncated or edited manifest may still be valid JSON.
        texts = [*manifest["files"].items(), *manifest["arrays"].items()]
        is_sound = all(isinstance(text, str) for pair in texts for text in pair)
    except (base.UserError, KeyError, TypeError, AttributeError):
        is_sound = False

    if not is_sound:
        raise base.UserError(f"{path} is damaged: {_MANIFEST} can't be read")
    if version != _FORMAT:
        raise base.UserError(f"{path} has checkpoint format {version!r}, expected {_FORMAT}")
    return manifest


def _check_files(path: pathlib.Path, files: dict[str, str]) -> None:
    """Checks that a folder holds exactly the files of its manifest."""
    there = _files(path)
    for name, expected in files.items():
        _check_file(path, name, expected, there)

    # Orbax might read a foreign file among the arrays as one of them.
    extra = sorted(there.keys() - files.keys() - {_MANIFEST})
    if extra:
        raise base.UserError(f"{path} is damaged: {extra[0]} is not in {_MANIFEST}")


def _check_file(
    path: pathlib.Path, name: str, expected: str, there: Mapping[str, pathlib.Path]
) -> None:
    """Checks one file against its checksum; `there` lists the folder's files."""
    # Looked up in the list, since a hostile manifest could name files outside of the folder.
    if name not in there:
        raise base.UserError(f"{path} is damaged: {name} is missing")
    checksum = _checksum(there[name])
    if checksum != expected:
        raise base.UserError(
            f"{path} is damaged: {name} has sha256 {checksum[:12]}, expected {expected[:12]}"
        )


def check_same(path: pathlib.Path, tree: PyTree, expected: PyTree) -> None:
    """Checks that a tree read from a folder has the structure, shapes and types of another one.

    Args:
      path: the folder, for the message.
      tree: what was read from it.
      expected: the other tree, of arrays or their shapes.

    Raises:
      StructureError: they differ.
    """
    _check_kinds(path, describe(tree), describe(expected))


def _check_kinds(path: pathlib.Path, kinds: dict[str, str], expected: dict[str, str]) -> None:
    """Checks that two results of `describe` are equal."""
    # Expected leaves first, so that a missing one is named before a superfluous one.
    for name in [*expected, *kinds]:
        kind, wanted = kinds.get(name, "nothing"), expected.get(name, "nothing")
        if kind != wanted:
            raise StructureError(
                f"{path} holds another network or state: {name} is {kind}, expected {wanted}"
            )


def _nested(arrays: dict[str, str], path: pathlib.Path) -> PyTree:
    """Builds nested dicts of abstract arrays from a manifest's list of arrays."""
    tree: dict[str, Any] = {}  # dicts of dicts, at most `reading.MAX_DEPTH` deep
    for name, kind in arrays.items():
        *parents, last = name.split("/")
        try:
            node = tree
            for parent in parents[: reading.MAX_DEPTH]:
                node = node.setdefault(parent, {})
            node[last] = _abstract(kind)
        except TypeError:  # a typed random key, which only learners' states have
            raise base.UserError(
                f"{path} holds a learner's state, not parameters: {name:.80} is {kind:.80}"
            ) from None
        except (ValueError, AttributeError):
            raise base.UserError(
                f"{path} is damaged: {_MANIFEST} says that {name:.80} is {kind:.80}"
            ) from None
    return tree


def _abstract(kind: str) -> jax.ShapeDtypeStruct:
    """Inverse of `_kind`.

    Raises:
      TypeError: NumPy has no such type.
      ValueError: the shape is malformed.
    """
    dtype, _, shape = kind.removesuffix("]").partition("[")
    sizes = tuple(int(size) for size in shape.split(",") if size)
    if min(sizes, default=0) < 0:
        raise ValueError(kind)
    return jax.ShapeDtypeStruct(sizes, np.dtype(dtype))


def _check_size(tree: PyTree, path: pathlib.Path) -> None:
    """Checks that a manifest's arrays have at most `MAX_SIZE` bytes together."""
    size = sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))
    if size > MAX_SIZE:
        raise base.UserError(f"{path} has arrays of {size} bytes, at most {MAX_SIZE}")
