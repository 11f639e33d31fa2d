"""Robots that are down: thrown ones, how upright they are, and who acts for them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import hierarchy, locomotion, low_obs, recovery
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, posture, scene

GO1 = robots.load("go1")
MODEL = scene.build(GO1)
HEIGHT = posture.standing_height(MODEL)
STANDING = jnp.asarray(MODEL.key_qpos[0], jnp.float32)
ON_ITS_BACK = STANDING.at[2:7].set(jnp.array([0.07, 0.0, 1.0, 0.0, 0.0]))
ON_ITS_BELLY = STANDING.at[2].set(0.08)


@pytest.mark.parametrize(
    ("qpos", "expected"), [(STANDING, 1.0), (ON_ITS_BACK, 0.0), (ON_ITS_BELLY, 0.08 / HEIGHT)]
)
def test_uprightness(qpos, expected):
    assert float(recovery.uprightness(qpos, GO1, HEIGHT)) == pytest.approx(expected, abs=1e-5)


def test_what_slides_is_always_upright():
    assert float(recovery.uprightness(jnp.zeros(2), robots.load("point"), 0.0)) == 1.0


def test_a_thrown_robot_is_above_the_floor_and_keeps_its_place():
    at = engine_lib.reset(STANDING.at[:2].set(jnp.array([4.0, -2.0])), jnp.zeros(MODEL.nv))
    keys = jax.random.split(jax.random.key(0), 50)
    qpos = jax.vmap(lambda key: recovery.thrown(at, GO1, key).qpos)(keys)
    np.testing.assert_allclose(qpos[:, :2], np.tile([4.0, -2.0], (50, 1)))
    assert min(posture.lowest(MODEL, np.asarray(each, float)) for each in qpos) > 0.0
    np.testing.assert_allclose(jnp.linalg.norm(qpos[:, 3:7], axis=1), 1.0, atol=1e-5)
    up = jax.vmap(lambda each: recovery.uprightness(each, GO1, HEIGHT))(qpos)
    assert up.min() < 0.2 and up.max() > 0.8


def test_what_slides_is_not_thrown():
    config = dataclasses.replace(presets.LOW["stand"], robot="point")
    engine = engines.make(robots.load("point"), "mujoco")
    with pytest.raises(base.UserError, match="thrown_share = 1.0 is for robots with root 'free'"):
        locomotion.Locomotion.of_config(engine, config)


@pytest.mark.parametrize(
    ("qpos", "expected"), [(STANDING, 1.0), (ON_ITS_BACK, 2.0), (ON_ITS_BELLY, 2.0)]
)
def test_who_is_down_is_stood_up(qpos, expected):
    """Whoever stands walks; else the one that stands it up acts."""
    walk, stand = (lambda obs, key, value=value: jnp.full(12, value) for value in (1.0, 2.0))
    policy = hierarchy.getting_up(walk, stand, GO1, HEIGHT)
    physics = engine_lib.reset(qpos, jnp.zeros(MODEL.nv))
    obs = low_obs.observe(physics, jnp.zeros(2), jnp.int32(1), jnp.int32(0), GO1)
    np.testing.assert_array_equal(policy(obs, jax.random.key(0)), jnp.full(12, expected))


def test_actions_of_full_range_reach_as_far_as_the_robot_may_when_it_gets_up():
    options = low_config.LowInput(frame="canonical", full_range=True)
    physics = engine_lib.reset(ON_ITS_BACK, jnp.zeros(MODEL.nv))
    obs = low_obs.observe(physics, jnp.zeros(2), jnp.int32(1), jnp.int32(2), GO1)
    action = jnp.linspace(-1.0, 1.0, 12)
    ctrl = low_obs.ctrl_from_action(action, obs, GO1, options)
    assert float(jnp.abs(ctrl).max()) == pytest.approx(8.0)
    back = low_obs.action_from_ctrl(ctrl, obs, GO1, options)
    np.testing.assert_allclose(back, action, atol=1e-6)
