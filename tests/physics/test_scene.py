"""The scene that both engines run: who collides with whom, options, what is wrong with an MJCF."""

import dataclasses

import mujoco
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.physics import scene


@pytest.mark.parametrize("name", robots.NAMES)
def test_only_robot_against_floor_and_walls_collides(name):
    model = scene.build(robots.load(name))
    is_robot = (model.geom_bodyid > 0) & (model.body_mocapid[model.geom_bodyid] < 0)
    collides = (model.geom_contype[:, None] & model.geom_conaffinity[None]) > 0
    collides |= collides.T
    np.testing.assert_array_equal(collides, is_robot[:, None] != is_robot[None])


def test_what_breaks_down_leaves_no_file_and_says_nothing(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    model = scene.build(robots.load("point"))
    data = mujoco.MjData(model)
    data.qvel[:] = np.nan
    mujoco.mj_step(model, data)
    assert data.warning.number.any()
    assert not list(tmp_path.iterdir()) and capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", robots.NAMES)
def test_walls_are_cells(name):
    robot = robots.load(name)
    model = scene.build(robot)
    assert model.nmocap == robot.num_walls
    for i in range(robot.num_walls):
        np.testing.assert_array_equal(model.geom(scene.wall_name(i)).size, base.CELL / 2)
        assert model.body(scene.wall_name(i)).mocapid[0] == i
    assert model.opt.timestep == robot.physics_step


@pytest.mark.parametrize("name", robots.NAMES)
def test_defaults_of_the_robot_do_not_leak(name):
    """Floor and walls are the same for every robot."""
    ours, ants = scene.build(robots.load(name)), scene.build(robots.load("ant"))
    for part in (scene.FLOOR, scene.wall_name(0)):
        for field in ("friction", "solref", "solimp", "margin", "condim", "size"):
            np.testing.assert_array_equal(
                getattr(ours.geom(part), field), getattr(ants.geom(part), field)
            )


def test_walls_and_robots_have_no_contact_margin():
    """MJX ignores margins between boxes and round geoms, so that engines would differ."""
    for name in robots.NAMES:
        model = scene.build(robots.load(name))
        margins = {model.geom(i).name: model.geom_margin[i] for i in range(model.ngeom)}
        assert margins.pop(scene.FLOOR) == 0.01
        assert set(margins.values()) == {0.0}


def test_fluid_reaches_the_scene():
    swimmer, ant = (scene.build(robots.load(name)).opt for name in ("swimmer", "ant"))
    assert (swimmer.density, swimmer.viscosity) == (4000.0, 0.1)
    assert swimmer.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert ant.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


@pytest.mark.parametrize("text", ["", "<mujoco>", "<mujoco><worldbody><body/></worldbody>"])
def test_bad_mjcf(tmp_path, text):
    mjcf = tmp_path / "bad.xml"
    mjcf.write_text(text)
    with pytest.raises(base.UserError, match=r"robot 'ant': .*bad\.xml"):
        scene.build(dataclasses.replace(robots.load("ant"), mjcf=mjcf))


def test_missing_mjcf(tmp_path):
    with pytest.raises(base.UserError, match=r"nowhere\.xml"):
        scene.build(dataclasses.replace(robots.load("ant"), mjcf=tmp_path / "nowhere.xml"))
