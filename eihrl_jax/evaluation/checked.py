"""Checks of what is read from policy folders."""

import pathlib
from typing import Any

import jax

from eihrl_jax import base


def entry(meta: dict[str, Any], name: str, path: pathlib.Path) -> Any:
    """Returns an entry of a policy's meta.json.

    Raises:
      base.UserError: there is none.
    """
    if name not in meta:
        raise base.UserError(f"{path}: meta.json lacks {name!r}")
    return meta[name]


def shapes(params: Any, expected: Any, path: pathlib.Path) -> None:
    """Checks that parameters are those of the network that meta.json describes.

    Raises:
      base.UserError: one has another shape, or is missing, or is one too many.
    """
    found = {jax.tree_util.keystr(k): v.shape for k, v in jax.tree.leaves_with_path(params)}
    wanted = {jax.tree_util.keystr(k): v.shape for k, v in jax.tree.leaves_with_path(expected)}
    for name in sorted(found.keys() | wanted.keys()):
        if found.get(name) != wanted.get(name):
            raise base.UserError(
                f"{path}: parameter {name} has shape {found.get(name)}, "
                f"expected {wanted.get(name)} for the network of its meta.json"
            )
