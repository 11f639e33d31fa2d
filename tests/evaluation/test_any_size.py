"""A high level that searches its map is at home in mazes of any size."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import mazes, robots
from eihrl_jax.config import high as high_config
from eihrl_jax.envs import raster, subgoals
from eihrl_jax.evaluation import loading, rollouts
from eihrl_jax.mazes import paths
from eihrl_jax.networks import actor_critic
from eihrl_jax.runs import policies, progress

SNAKE = """
#####################
#S........#.........#
#########.#.#######.#
#.......#.#.#.....#.#
#.#####.#.#.#.###.#.#
#.#...#...#...#.#...#
#.#.#.#########.#####
#...#..............1#
#####################
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a policy whose map had five cells a side, as it is before training."""
    path = tmp_path_factory.mktemp("search") / "high"
    view = raster.View(extent=15.0, pixels=15, map_radius=2)
    options = high_config.Network(kind="search", num_iterations=4, look_ahead=2)
    params = actor_critic.make(options).init(jax.random.key(0), jnp.zeros(view.obs_shape, bool))
    meta = {"view": dataclasses.asdict(view), "network": dataclasses.asdict(options)}
    meta |= {"movement": {"step": 3.0, "sigma": 0.0, "anchored": True}}
    policies.save(path, kind="high", params=params, meta=meta)
    return path


def test_its_map_is_as_large_as_the_largest_maze(folder):
    high = loading.load_high(str(folder))
    assert high.view.map_radius == 2 and high.anchored
    stacked = mazes.stack([mazes.load("u"), mazes.parse(SNAKE)])
    assert high.view_in(stacked).obs_shape == (9 + 16, 21 + 16, 4)
    patch = loading.load_high("uniform")
    assert patch.view_in(stacked) == patch.view and not patch.anchored


def run(high, maze, num_episodes=4):
    """Runs episodes of a point that the oracle moves, without offsets."""
    robot, stacked = robots.load("point"), mazes.stack([maze])
    gait = subgoals.gait(robot, None, 3.0, 0.0)
    view = high.view_in(stacked)
    env = loading.oracle_env(robot, stacked, view, gait=gait, anchored=high.anchored)
    plan = rollouts.Plan(mazes={"maze": maze}, seeds=(0,), num_episodes=num_episodes)
    with progress.Progress("maze", plan.num_decisions) as bar:
        return rollouts.Runner(env, plan).run(high.policy, bar)["maze"].episodes


def test_who_knows_the_map_goes_the_shortest_way(folder):
    maze = mazes.parse(SNAKE)
    for high in (
        loading.load_high("shortest"),
        loading.load_high(str(folder), greedy=True, knows="map"),
    ):
        episodes = run(high, maze)
        assert high.view_in(mazes.stack([maze])).knows == "map"
        np.testing.assert_array_equal(episodes.decisions, paths.longest_tour(maze))
        np.testing.assert_array_equal(episodes.shortest, episodes.decisions)


@pytest.mark.parametrize("name", ["search", "frontier"])
def test_it_finds_a_goal_that_is_far_beyond_its_training_s_map(folder, name):
    high = loading.load_high(str(folder) if name == "search" else name, greedy=True)
    maze = mazes.parse(SNAKE)
    shortest, episodes = paths.longest_tour(maze), run(high, maze)
    np.testing.assert_array_equal(episodes.achieved, 1)
    assert shortest > 40 and (episodes.decisions >= shortest).all()


def test_frontier_goes_for_the_nearest_unseen_cell_unless_a_goal_is_in_view():
    """In a corridor: the unseen is two moves to the east, or seven to the west."""
    chart = np.zeros((13, 13, 4), bool)
    chart[..., 0] = True
    chart[6, 1:12, 0] = False
    chart[6, 8, 2] = True
    chart[6, [1, 10], 3] = True
    choose = loading.load_high("frontier").policy
    key = jax.random.key(0)
    assert choose(jnp.asarray(chart), key) == 0
    chart[6, 2, 1] = True
    assert choose(jnp.asarray(chart), key) == 1
