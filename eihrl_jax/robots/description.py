"""A user's own robot: an MJCF file and a short description beside it, in TOML."""

import dataclasses
import json
import pathlib
import tomllib

from eihrl_jax import base
from eihrl_jax.config import codec
from eihrl_jax.robots import robot as robot_lib

SUFFIX = ".toml"
"""How the name of a description ends."""


def read(path: pathlib.Path) -> robot_lib.Robot:
    """Reads the description of a robot, whose keys are the attributes of `robot.Robot`.

    Args:
      path: the file; `mjcf` in it is relative to its folder.

    Raises:
      base.UserError: it can't be read, lacks something, or says something impossible.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text)
    except OSError as error:
        raise base.UserError(f"robot {str(path)!r}: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise base.UserError(f"robot {str(path)!r} is no TOML: {error}") from None
    try:
        described = codec.from_json(robot_lib.Robot, json.dumps(values), source="description")
    except (base.UserError, TypeError) as error:  # JSON has no dates
        raise base.UserError(f"robot {str(path)!r}: {error}") from None
    return dataclasses.replace(described, mjcf=path.parent / described.mjcf)
