"""Options of listing what is shipped."""

from typing import Literal

from eihrl_jax.config import limits

Part = Literal["policies", "robots", "mazes", "suites"]
"""Kinds of what is shipped."""

PARTS: tuple[Part, ...] = ("policies", "robots", "mazes", "suites")


@limits.dataclass
class ListConfig:
    """Lists what is shipped, each with what it is: policies, robots, mazes and suites of mazes.

    Attributes:
      what: of these; default: all. `eihrl maze NAME` shows a maze, or the mazes of a suite.
    """

    what: limits.Several[Part] = PARTS
