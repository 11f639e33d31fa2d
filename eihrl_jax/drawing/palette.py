"""Colours and type that all pictures share."""

import pathlib

import matplotlib
import matplotlib.colors
import numpy as np
from jaxtyping import Float
from PIL import ImageFont

PAPER = "#FBFAF7"
INK = "#2B3240"
MUTED = "#8A91A0"
FLOOR = "#EFEBE2"
FLOOR_ALTERNATE = "#E8E3D8"
WALL = "#66758C"
GOAL = "#F4B23C"
GOAL_ACHIEVED = "#58B27C"
ROBOT = "#D9482B"
ROBOT_LIMB = "#EE8A4A"
TRAIL = "#2F6DB5"
ARROW = "#123E73"
CURVE = ("#2F6DB5", "#D9482B", "#3F9B6C", "#8F5FB0", "#C98A12")
UNSEEN = "#C9CDD4"  # on the planner's map
HEAT = "inferno"  # its lightness grows evenly, so that it reads in grey as well


def rgb(colour: str) -> Float[np.ndarray, "3"]:
    """Returns red, green and blue in [0, 1] of a colour like "#FBFAF7"."""
    return np.array(matplotlib.colors.to_rgb(colour), np.float32)


def font(size: int, *, is_bold: bool = False) -> ImageFont.FreeTypeFont:
    """Returns the sans-serif font that comes with matplotlib, `size` in pixels."""
    name = "DejaVuSans-Bold.ttf" if is_bold else "DejaVuSans.ttf"
    folder = pathlib.Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / name), size)
