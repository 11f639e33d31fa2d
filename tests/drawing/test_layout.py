import jax.numpy as jnp
import matplotlib.figure
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.drawing import layout, palette
from eihrl_jax.envs import raster

TEXT = """\
#D#2##
#....D
#.S.##
######
"""


@pytest.fixture
def axes():
    return matplotlib.figure.Figure().add_subplot()


def test_plan_has_goals_doors_and_starts_to_scale(axes):
    maze = mazes.parse(TEXT)
    layout.draw(axes, maze, title="mine")
    image = axes.images[0].get_array()
    assert axes.images[0].get_extent() == [0.0, 6 * base.CELL, -4 * base.CELL, 0.0]
    np.testing.assert_allclose(image[0, 3], palette.rgb(palette.GOAL))
    np.testing.assert_allclose(image[0, 1], image[1, 5])
    assert not np.allclose(image[0, 1], palette.rgb(palette.WALL), atol=0.05)
    (text,) = [text for text in axes.texts if text.get_text()]
    assert text.get_text() == "2"
    assert text.get_position() == (3.5 * base.CELL, -0.5 * base.CELL)
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[2.5 * base.CELL, -2.5 * base.CELL]])
    assert axes.get_xlabel() == "x, units"


def test_open_door_is_a_goal_of_its_plan(axes):
    maze = mazes.maze.open_door(mazes.parse(TEXT), jnp.array([0, 1]))
    layout.draw(axes, maze)
    np.testing.assert_allclose(axes.images[0].get_array()[0, 1], palette.rgb(palette.GOAL))
    assert sorted(text.get_text() for text in axes.texts) == ["1", "2"]


def test_patch_is_coloured_by_channel_with_the_torso_in_the_middle(axes):
    view = raster.View(extent=9.0, pixels=5)
    patch = np.zeros((5, 5, 3), bool)
    for channel in range(3):
        patch[channel, :, channel] = True
    patch[2, 2] = True
    layout.draw_patch(axes, patch, view)
    image = axes.images[0].get_array()
    assert axes.images[0].get_extent() == [-4.5, 4.5, -4.5, 4.5]
    for row, colour in enumerate((palette.WALL, palette.GOAL, palette.ROBOT, palette.FLOOR)):
        np.testing.assert_allclose(image[row, 2], palette.rgb(colour))
