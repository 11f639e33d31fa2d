"""What the tests of physics share; MJX compiles for half a minute, so once per session."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import robots
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene


@pytest.fixture(scope="session")
def ant():
    """The ant on the C engine."""
    return engines.make(robots.load("ant"), "mujoco")


@pytest.fixture(scope="session")
def mjx_step():
    """The ant's compiled MJX control step of a batch."""
    return jax.jit(jax.vmap(engines.make(robots.load("ant"), "mjx").step))


@pytest.fixture(scope="session")
def standing():
    """Makes robots in the keyframe `stand`, joints and heights a little apart, moving."""

    def make(engine, num, seed=0, speed=0.0):
        rng = np.random.default_rng(seed)
        qpos = engine.model.key_qpos[0] + 0.05 * rng.normal(size=(num, engine.model.nq))
        qpos[:, :2] = 0.0
        heading = rng.uniform(-np.pi, np.pi, num)
        qvel = np.zeros((num, engine.model.nv))
        qvel[:, 0], qvel[:, 1] = speed * np.cos(heading), speed * np.sin(heading)
        return jax.vmap(engine_lib.reset)(jnp.asarray(qpos), jnp.asarray(qvel))

    return make


@pytest.fixture(scope="session")
def parked():
    """Makes the positions of wall boxes that are out of everybody's way."""

    def make(engine, *lead):
        return jnp.asarray(np.full((*lead, engine.robot.num_walls, 2), scene.PARKED_XY, np.float32))

    return make


@pytest.fixture(scope="session")
def random_ctrls():
    """Draws controls of any leading shape, uniform in [-1, 1]."""

    def draw(engine, *lead, seed=1):
        drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (*lead, engine.model.nu))
        return jnp.asarray(drawn, jnp.float32)

    return draw
