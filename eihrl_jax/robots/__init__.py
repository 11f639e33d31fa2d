"""Robot models and the numbers by which the hierarchy drives them."""

from eihrl_jax.robots.files import ASSETS, NAMES, load
from eihrl_jax.robots.robot import Robot

__all__ = ["ASSETS", "NAMES", "Robot", "load"]
