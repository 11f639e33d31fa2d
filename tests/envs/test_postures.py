"""Posture banks: plausible, saved and loaded intact, refused when damaged or another robot's."""

import dataclasses
import functools

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.envs import postures, raster
from eihrl_jax.physics import scene
from eihrl_jax.storage import archives

VIEW = raster.View()


@functools.cache
def synthetic_bank(name):
    """More postures than silhouettes are drawn at once, and no multiple of it."""
    return postures.synthetic(robots.load(name), 70)


def lowest_point(model, qpos):
    """Height of the lowest point of a robot made of spheres and capsules, as MuJoCo has it."""
    data = mujoco.MjData(model)
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    own = np.flatnonzero(model.geom_conaffinity == 0)
    is_capsule = model.geom_type[own] == mujoco.mjtGeom.mjGEOM_CAPSULE
    assert (is_capsule | (model.geom_type[own] == mujoco.mjtGeom.mjGEOM_SPHERE)).all()
    half = np.where(is_capsule, model.geom_size[own, 1], 0.0)
    rise = half * abs(data.geom_xmat[own].reshape(-1, 3, 3)[:, 2, 2])
    return (data.geom_xpos[own, 2] - rise - model.geom_size[own, 0]).min()


def bank_of(num):
    """Any finite numbers do for files."""
    qpos = np.random.default_rng(0).normal(size=(num, 15))
    return postures.PostureBank(qpos=jnp.asarray(qpos, jnp.float32).at[:, :2].set(0.0))


@pytest.mark.parametrize("name", robots.NAMES)
def test_synthetic_postures_are_plausible(name):
    robot = robots.load(name)
    model = scene.build(robot)
    bank = synthetic_bank(name)
    qpos = np.asarray(bank.qpos)
    assert qpos.shape == (70, model.nq) and qpos.dtype == np.float32
    np.testing.assert_array_equal(qpos[:, :2], 0.0)
    for joint in np.flatnonzero(model.jnt_limited):
        values = qpos[:, model.jnt_qposadr[joint]]
        low, high = model.jnt_range[joint]
        assert (values >= low).all() and (values <= high).all() and np.ptp(values) > 0.1
    if robot.root == "free":
        np.testing.assert_allclose(np.linalg.norm(qpos[:, 3:7], axis=1), 1.0, atol=1e-6)
        assert abs(lowest_point(model, qpos[3])) < 1e-5, "it stands on the floor"
        yaw = 2 * np.arctan2(qpos[:, 6], qpos[:, 3])
        assert np.ptp(yaw) > np.pi
    if robot.healthy_z is not None:
        low, high = robot.healthy_z
        assert np.mean((qpos[:, 2] > low) & (qpos[:, 2] < high)) > 0.9


def test_seeds():
    swimmer = robots.load("swimmer")
    first, again, other = (postures.synthetic(swimmer, 8, seed).qpos for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("name", robots.NAMES)
def test_footprints(name):
    """The torso is in the middle, the silhouette within the robot's reach, and postures differ."""
    robot = robots.load(name)
    bank = synthetic_bank(name)
    drawn = np.asarray(postures.footprints(robot, bank, VIEW))
    assert drawn.shape == (70, VIEW.pixels, VIEW.pixels) and drawn.dtype == bool
    middle = VIEW.pixels // 2
    assert drawn[:, middle, middle].all()
    i, j = np.nonzero(drawn.any(0))
    far = np.hypot(i - middle, j - middle).max() * VIEW.pitch
    assert far < robot.reach + VIEW.pitch
    if name != "point":
        assert len(np.unique(drawn, axis=0)) > 10


def test_footprints_show_the_recorded_heading():
    """A straight swimmer is a bar along its heading; north is up."""
    swimmer = robots.load("swimmer")
    qpos = jnp.zeros((2, 5)).at[1, 2].set(jnp.pi / 2)
    drawn = np.asarray(postures.footprints(swimmer, postures.PostureBank(qpos=qpos), VIEW))
    assert np.ptp(np.nonzero(drawn[0])[0]) == 0 and np.ptp(np.nonzero(drawn[0])[1]) == 6
    np.testing.assert_array_equal(drawn[1], drawn[0].T)


def test_save_and_load(tmp_path):
    ant = robots.load("ant")
    bank = bank_of(16)
    path = tmp_path / "postures.npz"
    postures.save(bank, path, ant)
    np.testing.assert_array_equal(postures.load(path, ant).qpos, bank.qpos)
    assert [file.name for file in tmp_path.iterdir()] == ["postures.npz"]


def test_the_origin_is_the_torso_even_in_a_careless_file(tmp_path):
    ant = robots.load("ant")
    bank = bank_of(4)
    moved = postures.PostureBank(qpos=bank.qpos.at[:, :2].set(7.0))
    postures.save(moved, tmp_path / "moved.npz", ant)
    np.testing.assert_array_equal(postures.load(tmp_path / "moved.npz", ant).qpos, bank.qpos)


def test_another_robots_bank_is_refused(tmp_path):
    path = tmp_path / "postures.npz"
    postures.save(bank_of(4), path, robots.load("ant"))
    with pytest.raises(base.UserError, match="is of robot 'ant', expected 'point'"):
        postures.load(path, robots.load("point"))


def test_a_damaged_bank_is_named(tmp_path):
    ant, path = robots.load("ant"), tmp_path / "postures.npz"
    postures.save(bank_of(32), path, ant)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(base.UserError, match=r"posture bank .*postures\.npz is damaged"):
        postures.load(path, ant)


@pytest.mark.parametrize(
    ("qpos", "message"),
    [
        (np.zeros((3, 7), np.float32), r"shape \(3, 7\), expected \(N, 15\)"),
        (np.zeros((0, 15), np.float32), r"shape \(0, 15\)"),
        (np.full((2, 15), np.nan, np.float32), "finite float32"),
        (np.zeros((2, 15)), "finite float32"),
        (np.array([[{"a": 1}]]), "can't be read"),
    ],
)
def test_wrong_contents_are_refused(tmp_path, qpos, message):
    path = tmp_path / "postures.npz"
    archives.write(path, {"robot": np.array("ant"), "qpos": qpos})
    with pytest.raises(base.UserError, match=message):
        postures.load(path, robots.load("ant"))


def test_missing_bank(tmp_path):
    with pytest.raises(base.UserError, match="nowhere"):
        postures.load(tmp_path / "nowhere.npz", robots.load("ant"))


def test_a_robot_without_shipped_bank_gets_a_synthetic_one():
    eel = dataclasses.replace(robots.load("swimmer"), name="eel")
    np.testing.assert_array_equal(postures.for_robot(eel).qpos, postures.synthetic(eel).qpos)
