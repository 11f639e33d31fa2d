"""Robots by name, and your own: an MJCF file and a short description beside it, in TOML."""

import dataclasses
import json
import os
import pathlib

from eihrl_jax import base
from eihrl_jax.config import codec
from eihrl_jax.robots import ant, go1, humanoid, point, swimmer
from eihrl_jax.robots.robot import Robot
from eihrl_jax.storage import reading

ASSETS = pathlib.Path(__file__).parent / "assets"
"""Folder of the models that come with the package."""

SUFFIX = ".toml"
"""How the name of a description ends."""

_MODULES = (point, ant, swimmer, humanoid, go1)
_ROBOTS = {module.ROBOT.name: module.ROBOT for module in _MODULES}

DESCRIPTIONS = {
    module.ROBOT.name: (module.__doc__ or "").partition(": ")[2].partition(".\n")[0].rstrip(".")
    for module in _MODULES
}
"""What each of them is, in a few words."""

NAMES = tuple(_ROBOTS)
"""The robots that come with the package; each has its own module."""


def load(name: str) -> Robot:
    """Returns one of the package's robots, or one of your own.

    Args:
      name: one of `NAMES`, or the path of a description, see `read` and `docs/robots.md`.

    Raises:
      base.UserError: there is no such robot, or its description is wrong.

    >>> load("ant").steps_per_subgoal  # control steps
    25
    """
    if name in _ROBOTS:
        return _ROBOTS[name]
    if not name.endswith(SUFFIX):
        raise base.UserError(
            f"robot {name!r} is unknown; {base.did_you_mean(name, NAMES)}choose one of "
            f"{', '.join(NAMES)}, "
            f"or name a description that ends in {SUFFIX}"
        )

    robot = read(pathlib.Path(name))
    # Policies are told apart by their robot's name.
    if robot.name in NAMES:
        raise base.UserError(f"robot {name!r}: name {robot.name!r} is taken by the package")
    return robot


def read(path: pathlib.Path) -> Robot:
    """Reads the description of a robot, whose keys are the attributes of `robot.Robot`.

    Args:
      path: the file; `mjcf` in it is relative to its folder.

    Raises:
      base.UserError: it can't be read, lacks something, or says something impossible.
    """
    try:
        values = reading.read_toml(path)
    except OSError as error:
        raise base.UserError(f"robot {str(path)!r}: {error.strerror}") from None
    except base.UserError as error:
        raise base.UserError(f"robot {error}") from None

    try:
        # By way of JSON, so that descriptions are checked by what checks configs.
        robot = codec.from_json(Robot, json.dumps(values), source="description")
    except (base.UserError, TypeError) as error:  # JSON has no dates
        raise base.UserError(f"robot {str(path)!r}: {error}") from None
    return dataclasses.replace(robot, mjcf=path.parent / robot.mjcf)


def text(robot: Robot, folder: pathlib.Path) -> str:
    """Returns a description as `read` reads it from a file in `folder`; defaults are left out."""
    lines = []
    for field in dataclasses.fields(robot):
        value = getattr(robot, field.name)
        if field.name == "mjcf":
            value = os.path.relpath(value, folder)
        # TOML's numbers, words and lists are JSON's.
        if value != field.default and not dataclasses.is_dataclass(value):
            lines.append(f"{field.name} = {json.dumps(value)}\n")
    return "".join(lines)
