"""What is shipped still does with today's code what its README says."""

import pytest

from eihrl_jax import robots
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.evaluation import loading
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import policies


@pytest.mark.parametrize("name", policies.shipped("high"))
def test_high_levels_load(name):
    assert callable(loading.load_high(name).policy)


@pytest.mark.parametrize("name", policies.shipped("low"))
def test_low_levels_load(name):
    assert callable(loading.load_low(name, robots.load(name)))


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
