"""Robot models and the numbers by which the hierarchy drives them."""

import importlib
import pathlib

from eihrl_jax import base
from eihrl_jax.robots import description, robot

NAMES = ("point", "ant", "swimmer", "humanoid")
"""The robots that come with the package; each has its own module."""


def load(name: str) -> robot.Robot:
    """Returns one of the package's robots, or one of your own.

    Args:
      name: one of `NAMES`, or the path of a description, see `description` and `docs/robots.md`.

    Raises:
      base.UserError: there is no such robot, or its description is wrong.
    """
    if name.endswith(description.SUFFIX):
        found = description.read(pathlib.Path(name))
        if found.name in NAMES:
            raise base.UserError(f"robot {name!r}: name {found.name!r} is taken by the package")
        return found
    if name not in NAMES:
        raise base.UserError(
            f"robot {name!r} is unknown; choose one of {', '.join(NAMES)}, "
            f"or name a description that ends in {description.SUFFIX}"
        )
    return importlib.import_module(f"eihrl_jax.robots.{name}").ROBOT
