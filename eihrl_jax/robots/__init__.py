"""Robot models and the numbers by which the hierarchy drives them."""

import importlib

from eihrl_jax import base
from eihrl_jax.robots import robot

NAMES = ("point", "ant", "swimmer", "humanoid")
"""The robots that come with the package; each has its own module."""


def load(name: str) -> robot.Robot:
    """Returns one of the package's robots.

    Args:
      name: one of `NAMES`. For a robot of your own, write a `robot.Robot`; see `assets/README.md`.

    Raises:
      base.UserError: there is no such robot.
    """
    if name not in NAMES:
        raise base.UserError(f"robot {name!r} is unknown; choose one of {', '.join(NAMES)}")
    return importlib.import_module(f"eihrl_jax.robots.{name}").ROBOT
