"""What is shipped still does with today's code what its README says."""

import dataclasses

import jax
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.evaluation import loading, standing
from eihrl_jax.physics import engines, scene
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import policies


@pytest.mark.parametrize("name", policies.shipped("high"))
def test_high_levels_load(name):
    assert callable(loading.load_high(name).policy)


@pytest.mark.parametrize("name", policies.shipped("low"))
def test_low_levels_load(name):
    robot = policies.read_meta(policies.find(name, "low"))["robot"]
    assert callable(loading.load_low(name, robots.load(robot)))


def test_subgoals_are_anchored_where_both_levels_know_them():
    high, other = loading.load_high("best-random-0"), loading.load_high("paper-random-0")
    ant = robots.load("ant")
    assert high.anchors(ant)
    assert not high.anchors(dataclasses.replace(ant, anchored=False)) and not other.anchors(ant)


@pytest.mark.slow
def test_the_go1_stands_up_again():
    robot = robots.load("go1")
    engine = engines.make(robot, "mujoco")
    shares = {}
    for stand in (None, "none"):
        policy = loading.load_low("go1", robot, stand=stand)
        found = standing.measure(engine, policy, 100, jax.random.key(0))
        assert found.num_down > 50
        shares[stand] = found.shares[4]
    assert shares[None] > 0.9 and shares["none"] < 0.2


def test_low_levels_of_a_robot_that_has_changed_since_are_refused(tmp_path):
    robot = robots.load("point")
    params, meta = policies.load(policies.find("point", "low"), kind="low")
    same = scene.fingerprint(scene.build(robot), robot)
    for name, text in (("same", same), ("other", same[::-1])):
        meta["fingerprint"] = text
        policies.save(tmp_path / name, kind="low", params=params, meta=meta)
    assert callable(loading.load_low(str(tmp_path / "same"), robot))
    with pytest.raises(base.UserError, match="is a policy of another version of robot 'point'"):
        loading.load_low(str(tmp_path / "other"), robot)


@pytest.mark.parametrize("name", policies.shipped("baseline"))
def test_baselines_reach_the_goal_of_their_maze(name, tmp_path):
    _, maze, _ = name.split("-")
    options = evaluate_config.EvaluateConfig(
        mazes=(maze,),
        movement=("full",),
        high=(name,),
        episodes=40,
        out=tmp_path / "out",
        animate="none",
        heatmaps=False,
    )
    (cell,) = evaluations.evaluate(options).cells
    assert cell.success.rate > 0.3  # of 500 episodes it is 0.69 and 0.64
