"""Capsules against MuJoCo's own kinematics and, for shapes that they only contain, its geometry."""

import pathlib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import robots
from eihrl_jax.physics import kinematics, scene

CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)


def robot_geoms(model):
    bodies = model.geom_bodyid
    return np.flatnonzero((bodies > 0) & (model.body_mocapid[bodies] < 0))


@pytest.mark.parametrize("name", robots.NAMES)
def test_capsules_are_mujocos(name):
    """Every robot of the package, free and planar, in any posture, under `vmap`."""
    model = scene.build(robots.load(name))
    qpos = np.random.default_rng(0).normal(size=(8, model.nq)).astype(np.float32)
    start, end, radius = jax.jit(jax.vmap(kinematics.capsules(model)))(qpos)
    assert start.dtype == end.dtype == radius.dtype == jnp.float32
    geoms = robot_geoms(model)
    assert len(geoms) == start.shape[1] > 0
    half = np.where(model.geom_type[geoms] == CAPSULE, model.geom_size[geoms, 1], 0.0)[:, None]
    data = mujoco.MjData(model)
    for row in range(len(qpos)):
        data.qpos = qpos[row]
        mujoco.mj_kinematics(model, data)
        axis = half * data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2]
        np.testing.assert_allclose(start[row], data.geom_xpos[geoms] - axis, atol=2e-6)
        np.testing.assert_allclose(end[row], data.geom_xpos[geoms] + axis, atol=2e-6)
        np.testing.assert_allclose(radius[row], model.geom_size[geoms, 0], rtol=1e-6)


OWN_ROBOT = """
<mujoco>
  <worldbody>
    <body name="torso" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.2 0.5 0.1" pos="0.1 0 0" euler="10 20 30"/>
      <body pos="0.3 0 0">
        <joint type="ball" pos="0.1 0.05 0"/>
        <geom type="ellipsoid" size="0.1 0.2 0.3"/>
        <geom type="ellipsoid" size="0.4 0.2 0.3" pos="0 0.5 0"/>
        <body pos="0.3 0 0" quat="1 0.2 0 0.1">
          <joint type="slide" axis="1 2 0"/>
          <joint type="hinge" axis="0 1 1" pos="0 0.1 0" ref="20"/>
          <geom type="cylinder" size="0.1 0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_other_shapes_are_inside_their_capsules():
    """Any model: random points on the geoms' surfaces, every kind of joint."""
    model = mujoco.MjModel.from_xml_string(OWN_ROBOT)
    rng = np.random.default_rng(1)
    qpos = rng.normal(size=model.nq)
    found = jax.jit(kinematics.capsules(model))(jnp.asarray(qpos, jnp.float32))
    start, end, radius = map(np.asarray, found)
    data = mujoco.MjData(model)
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    for row, geom in enumerate(robot_geoms(model)):
        local = surface(model, geom, rng.normal(size=(500, 3)))
        points = data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T
        axis = end[row] - start[row]
        along = np.clip((points - start[row]) @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
        distance = np.linalg.norm(points - (start[row] + along[:, None] * axis), axis=1)
        assert distance.max() <= radius[row] + 1e-5
        assert distance.max() >= 0.9 * radius[row], "the capsule is wider than it need be"


def surface(model, geom, directions):
    """Points on the surface of a geom, in its frame."""
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return directions / np.linalg.norm(directions / size, axis=1, keepdims=True)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        size = np.array([size[0], size[0], size[1]])
        across = np.linalg.norm(directions[:, :2], axis=1) / size[0]
        return directions / np.maximum(across, np.abs(directions[:, 2]) / size[2])[:, None]
    return directions / np.abs(directions / size).max(1, keepdims=True)


def test_robot_without_floor_and_walls_gives_the_same_capsules():
    path = pathlib.Path(robots.load("ant").mjcf)
    alone = mujoco.MjModel.from_xml_path(str(path))
    qpos = jnp.asarray(alone.key_qpos[0], jnp.float32)
    for a, b in zip(
        kinematics.capsules(alone)(qpos),
        kinematics.capsules(scene.build(robots.load("ant")))(qpos),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
