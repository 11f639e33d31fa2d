"""The entries of a policy's meta.json that are needed to use the policy; others are ignored.

A folder may come from a stranger: checksums tell that it is whole, not that it makes sense.
"""

import dataclasses
import json
import pathlib
from collections.abc import Callable
from typing import Annotated, TypeVar

import jax

from eihrl_jax import base
from eihrl_jax.config import codec, limits, presets
from eihrl_jax.config import high as high_config
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import raster
from eihrl_jax.runs import checkpoint, policies
from eihrl_jax.storage import reading

Width = Annotated[int, limits.Range(1, 65_536)]
"""Of a layer."""


@dataclasses.dataclass(frozen=True)
class Movement:
    """How a high level was moved while it trained; only what matters afterwards."""

    anchored: bool = False


@dataclasses.dataclass(frozen=True)
class High:
    """Of a high level; defaults are for older policies without these entries."""

    view: raster.View
    network: high_config.Network
    greedy: bool = False


@limits.dataclass
class Low:
    """Of a low level."""

    low_input: low_config.LowInput
    num_actions: Width
    num_features: Width
    hidden: limits.Widths
    fingerprint: str | None = None


@limits.dataclass
class Baseline:
    """Of a baseline, its config left out."""

    method: Annotated[str, limits.OneOf(presets.BASELINES)]
    side_xy: tuple[int, int]


@dataclasses.dataclass(frozen=True)
class Law:
    """Where a low level's subgoals end, units."""

    along_mean: float
    along_std: float
    lateral_mean: float
    lateral_std: float


SchemaT = TypeVar("SchemaT", High, Movement, Low, Baseline, Law)


def read(meta: reading.Value, schema: type[SchemaT], path: pathlib.Path) -> SchemaT:
    """Returns what a meta.json says of a schema's fields.

    Args:
      meta: as `policies.load` returned it, or what stands inside of it.
      schema: one of the dataclasses above.
      path: the policy's folder.

    Raises:
      base.UserError: it is no object, or an entry is missing, of another type, or out of its
        limits.
    """
    if not isinstance(meta, dict):
        raise base.UserError(f"{path}: meta.json: {meta!r:.80} must be an object of entries")
    known = {field.name: field for field in dataclasses.fields(schema)}
    for name, field in known.items():
        if field.default is dataclasses.MISSING:
            policies.entry(meta, name, path)

    # By way of JSON, so that it is checked by what checks configs.
    chosen = {name: meta[name] for name in known if name in meta}
    return codec.from_json(schema, json.dumps(chosen), source=f"{path}: meta.json")


def check_params(params: base.Params, init: Callable[[], base.Params], path: pathlib.Path) -> None:
    """Checks that parameters are those of the network that a meta.json describes.

    Args:
      params: as `policies.load` returned them.
      init: makes the network's; only its shapes are asked for.
      path: the policy's folder.

    Raises:
      base.UserError: they aren't, or there is no such network.
    """
    try:
        expected = jax.eval_shape(init)
    except (TypeError, ValueError, ZeroDivisionError) as error:
        reason = str(error).partition("\n")[0]
        raise base.UserError(f"{path}: meta.json describes no network: {reason:.200}") from None
    checkpoint.check_same(path, params, expected)
