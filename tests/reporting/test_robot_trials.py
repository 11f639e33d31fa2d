"""Descriptions that are proposed for MJCF files, and all that is wrong with others, at once."""

import dataclasses
import pathlib
import re

import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import robot as robot_config
from eihrl_jax.physics import engines, posture, proposal, scene, trials
from eihrl_jax.reporting import robot_trials
from eihrl_jax.robots import files

ASSETS = robots.ASSETS
CART = pathlib.Path(__file__).parents[2] / "docs" / "robots" / "cart.toml"


@pytest.mark.parametrize("name", robots.NAMES)
def test_what_is_proposed_for_a_shipped_model_fits_it(name):
    ours, found = robots.load(name), proposal.propose(ASSETS / f"{name}.xml")
    assert found.root == ours.root and found.name == f"my-{name}"
    measured = posture.reach(scene.build(ours), ours)
    assert found.reach == pytest.approx(1.05 * measured, abs=0.02)
    assert 0.0 < found.body_radius < found.reach
    if ours.healthy_z is not None:
        height = scene.build(ours).key_qpos[0, 2]
        assert found.healthy_z[0] < height < found.healthy_z[1]
    assert trials.faults(engines.make(found).model, found) == []


def test_a_proposal_is_a_description(tmp_path):
    """Written beside a picture, it is read back as the robot that was tried out."""
    out = tmp_path / "out"
    trial = robot_trials.try_out(robot_config.RobotConfig(file=ASSETS / "ant.xml", out=out))
    found = robots.load(str(out / "robot.toml"))
    proposed = proposal.propose(ASSETS / "ant.xml")
    assert found.mjcf.resolve() == proposed.mjcf.resolve()
    assert dataclasses.replace(found, mjcf=proposed.mjcf) == proposed
    assert (out / "robot.png").stat().st_size > 5_000
    assert "8 joints, 8 actuators" in robot_trials.summary(trial)
    robot_trials.check(trial)


def test_small_robots_get_cells_that_fit_and_fast_ones_eight_boxes(tmp_path):
    text = (ASSETS / "point.xml").read_text()
    small = tmp_path / "small.xml"
    small.write_text(re.sub(r'size="[0-9.]+"', 'size="0.1"', text))
    found = proposal.propose(small)
    assert found.cell == pytest.approx(2.4 * found.reach, abs=0.05)
    fast = tmp_path / "fast.xml"
    fast.write_text(re.sub(r'gear="[0-9. ]+"', 'gear="160"', text))
    found = proposal.propose(fast)
    assert found.max_speed is not None and found.num_walls == 8
    assert "max_speed" in files.text(found, tmp_path)


def test_a_biped_that_falls_without_control_has_no_fault(tmp_path):
    trial = robot_trials.try_out(
        robot_config.RobotConfig(file=ASSETS / "humanoid.xml", out=tmp_path / "out")
    )
    assert trial.faults == [] and "leaves healthy_z after 0." in robot_trials.summary(trial)


def test_all_faults_are_told_at_once(tmp_path):
    ant = robots.load("ant")
    # It turns by half a turn where it says a quarter, is longer than said, and stands too high.
    symmetry = dataclasses.replace(
        ant.symmetry, num_turns=1, turn_joints=(), turn_controls=(), mirror_joints=(*range(1, 9),)
    )
    start = (0.0, 0.0, 1.5, 1.0, 0.0, 0.0, 0.0, *[0.0] * 8)
    wrong = dataclasses.replace(ant, reach=0.5, start=start, symmetry=symmetry)
    found = trials.faults(scene.build(wrong), wrong)
    for word in ("reach must be", "range of joints", "height 1.50", "isn't one of the physics"):
        assert sum(word in fault for fault in found) == 1
    assert len(found) == 4
    with pytest.raises(base.UserError, match="; the start posture") as error:
        robot_trials.check(robot_trials.Trial("", "", 0.0, found))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("robot", [*robots.NAMES, str(CART)])
def test_the_symmetries_that_we_ship_are_those_of_the_physics(robot):
    robot = robots.load(robot)
    assert trials.symmetry_error(scene.build(robot), robot) < 1e-6


def test_a_step_that_is_too_long_breaks_down():
    humanoid = dataclasses.replace(robots.load("humanoid"), physics_step=0.1)
    model = scene.build(humanoid)
    assert not trials.is_stable(model, humanoid)


@pytest.mark.parametrize("name", ["nowhere.xml", "empty.xml"])
def test_a_file_that_is_no_robot_is_named(tmp_path, name):
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    with pytest.raises(base.UserError, match=name):
        proposal.propose(tmp_path / name)
