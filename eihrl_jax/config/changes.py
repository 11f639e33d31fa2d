"""Configs that differ from another one in some options, which are named as on the command line."""

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

ConfigT = TypeVar("ConfigT")


def apply(config: ConfigT, options: Mapping[str, object]) -> ConfigT:
    """Returns a config with some options set; those of a config inside it as "inner.option".

    All are set at once, so that limits which relate several options are checked on the result.

    Raises:
      TypeError: there is no such option.
      UserError: a value is outside of its limits.

    >>> from eihrl_jax.config import high
    >>> changed = apply(high.HighConfig(), {"task.sigma": 0.0, "seed": 1})
    >>> changed.task.sigma, changed.task.maze, changed.seed
    (0.0, 'random', 1)
    """
    # Options of one inner config are gathered first: setting them one by one might break a limit
    # that relates two of them on the way.
    direct = {name: value for name, value in options.items() if "." not in name}
    inside: dict[str, dict[str, object]] = {}
    for name in options.keys() - direct.keys():
        outer, _, inner = name.partition(".")
        inside.setdefault(outer, {})[inner] = options[name]

    direct |= {name: apply(getattr(config, name), inner) for name, inner in inside.items()}
    return dataclasses.replace(config, **direct)  # pyright: ignore[reportArgumentType]
