"""Phantom walls: only the wall channel, only as often as asked, of the size asked."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, raster
from eihrl_jax.envs import phantoms

VIEW = raster.View(extent=9.0, pixels=15)


class Blank:
    """Shows no wall, a goal in the upper rows, and the robot in the lowest."""

    def reset(self, key):
        obs = jnp.zeros((15, 15, 3), bool).at[:5, :, 1].set(True).at[14, :, 2].set(True)
        zero, no = jnp.float32(0.0), jnp.array(False)
        return base.EnvState(None, obs, obs, zero, no, no, {}, key)

    def step(self, state, action):
        return state.replace(key=jax.random.split(state.key)[0])


def seen(probability):
    """Returns 200 observations after a step, and what they would be without phantoms."""
    env = phantoms.PhantomWalls(env=Blank(), view=VIEW, probability=probability)

    def step(key):
        return env.step(env.reset(key), jnp.int32(0)).obs

    keys = jax.random.split(jax.random.key(0), 200)
    return np.asarray(jax.jit(jax.vmap(step))(keys)), np.asarray(Blank().reset(keys[0]).obs)


def test_never_without_probability():
    obs, blank = seen(0.0)
    # The wall painted at reset would be there still.
    assert (obs == blank).all()


def test_walls_hide_neither_goals_nor_the_robot():
    obs, blank = seen(1.0)
    assert (obs[..., 1:] == blank[..., 1:]).all()
    assert not (obs[..., 0] & obs[..., 1]).any()
    assert obs[..., 0].any((1, 2)).mean() > 0.5


@pytest.mark.parametrize("corner", [0.0, 0.999])
def test_rectangles_are_one_to_two_cells_wide_inside_the_view(corner):
    draws = jnp.array([corner, 0.5, 0.5, 0.5])
    area = np.asarray(phantoms.rectangle(draws, VIEW))
    rows, columns = area.any(1).sum(), area.any(0).sum()
    assert rows == 5 if corner == 0.0 else rows in (9, 10)
    assert columns in (7, 8)
    assert area.sum() == rows * columns


def test_every_pixel_is_painted_about_equally_often():
    draws = jax.random.uniform(jax.random.key(1), (20_000, 4))
    share = np.asarray(jax.vmap(lambda row: phantoms.rectangle(row, VIEW))(draws).mean(0))
    assert share.min() > 0.8 * share.max()
