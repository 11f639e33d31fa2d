"""Final policies: parameters of one level as a small checkpoint, with what is needed to use them.

A policy is a folder with `arrays/` (see `checkpoint`) and `meta.json`: which level (or
that it is a whole baseline), which robot, sizes of network and view, the config, versions and
steps. Shipped ones lie in `eihrl_jax/pretrained/<name>/<kind>`, those of a run in `<run>/policy`,
and until that is there in `<run>/latest`.
"""

import json
import pathlib
import sys
from collections.abc import Iterable
from typing import Any, Literal, TypeAlias

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.runs import checkpoint
from eihrl_jax.storage import reading

Kind = Literal["high", "low", "baseline"]
Meta: TypeAlias = dict[str, Any]
"""The entries of a policy's meta.json: JSON values by name."""

_NOUNS: dict[Kind, str] = {
    "high": "high-level policy",
    "low": "low-level policy",
    "baseline": "baseline",
}

PRETRAINED = base.PRETRAINED
"""Folder of the shipped policies."""

FOLDER = "policy"
"""Name of a run's final policy inside its run folder."""

LATEST = "latest"
"""Name of the policy of a run's last checkpoint, there until the run is finished."""


def save(
    path: pathlib.Path,
    *,
    kind: Kind,
    params: base.Params,
    meta: Meta,
    overwrite: bool = False,
) -> None:
    """Writes a policy to the new folder `path`, which appears only when it is complete.

    Args:
      path: the folder; what a killed save of it left is replaced.
      kind: the level.
      params: nested dicts of arrays.
      meta: JSON values; `robot` is required for the low level.
      overwrite: replace a policy that is already there, as a run that ends a second time does.

    Raises:
      UserError: something is already there.
      ValueError: a low level's robot isn't named.
    """
    if kind == "low" and "robot" not in meta:
        raise ValueError("a low-level policy needs its robot's name in meta")
    # `default=str`: configs hold paths.
    text = json.dumps({"kind": kind, **meta}, indent=2, default=str) + "\n"
    checkpoint.write(path, {"params": params}, files={"meta.json": text}, overwrite=overwrite)


def load(path: pathlib.Path, *, kind: Kind, robot: str | None = None) -> tuple[base.Params, Meta]:
    """Reads a policy after checking every byte of it.

    Args:
      path: a folder that `save` wrote; see `find`.
      kind: the level that is wanted.
      robot: name of the robot that is wanted, None for any.

    Returns:
      The parameters, and what `save` got as `meta`.

    Raises:
      UserError: it is no policy, damaged, or of another level or robot.
    """
    meta = read_meta(path)
    if meta["kind"] != kind:
        raise base.UserError(f"{path} is a {_NOUNS[meta['kind']]}, expected a {_NOUNS[kind]}")
    if robot is not None and meta.get("robot") != robot:
        raise base.UserError(
            f"{path} is a policy of robot {meta.get('robot')!r}, expected {robot!r}"
        )
    tree = checkpoint.read(path)
    if "params" not in tree:
        raise base.UserError(f"{path} is no policy: it has no parameters")
    params = tree["params"]
    _check_finite(params, path)
    return params, meta


def entry(meta: Meta, name: str, path: pathlib.Path) -> Any:
    """Returns an entry of a policy's meta.json.

    Args:
      meta: as `load` returned it.
      name: of the entry.
      path: the policy's folder.

    Raises:
      UserError: there is none.
    """
    if name not in meta:
        raise base.UserError(f"{path}: meta.json lacks {name!r}")
    return meta[name]


def find(name: str | pathlib.Path, kind: Kind) -> pathlib.Path:
    """Returns the folder of a policy, given a shipped name, a run folder or the folder itself.

    Of a run that isn't finished it is that of the last checkpoint; a line says so.

    Raises:
      UserError: there is none.
    """
    folder = _first(name, (kind,))
    if folder is not None:
        if folder.name == LATEST:
            print(f"{name} isn't finished: its last checkpoint is taken", file=sys.stderr)
        return folder

    # A run folder without policy gets its own message: the name itself was right.
    path = pathlib.Path(name)
    if (path / "config.json").is_file():
        raise base.UserError(f"{path} holds no policy yet: its training has just begun")
    names = shipped(kind)
    hint = base.did_you_mean(str(name), names)
    raise base.UserError(
        f"{name} is neither a policy nor a finished run; {hint}shipped {_NOUNS[kind]} names: "
        + (", ".join(names) or "none")
    )


def kind_of(name: str | pathlib.Path) -> Kind | None:
    """Returns what `name`, as `find` takes it, holds; None if it holds no policy.

    Raises:
      UserError: it holds a damaged one.
    """
    folder = _first(name, _NOUNS)
    return None if folder is None else read_meta(folder)["kind"]


def read_meta(path: pathlib.Path) -> Meta:
    """Returns the entries of a policy's meta.json; only the kind is checked.

    Raises:
      UserError: it can't be read, or names no kind.
    """
    meta = reading.parse_json(checkpoint.read_file(path, "meta.json"), f"{path}: meta.json")
    kind = meta.get("kind") if isinstance(meta, dict) else None
    if not isinstance(kind, str) or kind not in _NOUNS:
        raise base.UserError(f"{path}: meta.json names no kind of policy: {', '.join(_NOUNS)}")
    return meta


def _check_finite(params: base.Params, path: pathlib.Path) -> None:
    """Raises if parameters are NaN or infinite, with which a policy would act without an error."""
    for key, leaf in jax.tree_util.tree_leaves_with_path(params):
        if not np.isfinite(np.asarray(leaf)).all():
            name = jax.tree_util.keystr(key, simple=True, separator="/")
            raise base.UserError(f"{path} can't be used: {name} holds numbers that aren't finite")


def _first(name: str | pathlib.Path, kinds: Iterable[Kind]) -> pathlib.Path | None:
    """Returns the first complete policy's folder among the places that `name` may mean."""
    path = pathlib.Path(name)
    # A path comes first, so that a folder of one's own can have a shipped name.
    places = (path, path / FOLDER, path / LATEST, *(PRETRAINED / name / kind for kind in kinds))
    return next((place for place in places if checkpoint.is_complete(place)), None)


def shipped(kind: Kind) -> list[str]:
    """Names of the shipped policies of one level."""
    folders = sorted(PRETRAINED.glob(f"*/{kind}"))
    return [folder.parent.name for folder in folders if checkpoint.is_complete(folder)]
