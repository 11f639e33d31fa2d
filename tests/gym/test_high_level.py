"""High levels from elsewhere decide in our mazes, moved by the oracle and by low levels."""

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils import env_checker

import eihrl_jax
import eihrl_jax.gym
from eihrl_jax import base
from eihrl_jax.gym import HighLevelEnv, HighLevelVectorEnv

EAST, WEST, NORTH, SOUTH = range(base.NUM_DIRECTIONS)


@pytest.mark.parametrize("options", [{}, {"map_radius": 3, "knows": "goal"}])
def test_gymnasium_finds_nothing_wrong(options):
    env = gymnasium.make(eihrl_jax.gym.HIGH_LEVEL_ID, robot="point", **options).unwrapped
    env_checker.check_env(env, skip_render_check=True)
    assert env.observation_space.shape == ((7, 7, 4) if options else (15, 15, 3))
    assert env.action_space.n == base.NUM_DIRECTIONS


def test_the_same_seed_is_the_same_trajectory_as_in_the_bare_environment():
    robot, maze = eihrl_jax.load_robot("point"), eihrl_jax.load_maze("random")
    bare = eihrl_jax.OracleMaze.of_robot(robot, maze)
    state, step = jax.jit(bare.reset)(jax.random.key(3)), jax.jit(bare.step)

    envs, env = HighLevelVectorEnv(2, robot="point"), HighLevelEnv(robot="point")
    many, _ = envs.reset(seed=2)
    one, _ = env.reset(seed=3)
    for action in (NORTH, EAST, SOUTH, WEST):
        np.testing.assert_array_equal(one, state.obs)
        np.testing.assert_array_equal(many[1], one)
        state = step(state, np.int32(action))
        many, one = envs.step(np.array([WEST, action]))[0], env.step(action)[0]


@pytest.mark.parametrize("movement", base.MOVEMENTS)
def test_a_way_of_decisions_leads_to_the_goal(movement):
    env = HighLevelEnv("random", "point", movement, anchored=True, render_mode="rgb_array")
    env.reset(seed=0, options={"start_cell": (4, 4), "goal_cell": (3, 6)})
    assert env.render().shape == (480, 480, 3)
    for action in (EAST, EAST):
        _, reward, terminated, truncated, info = env.step(action)
        assert (reward, terminated, truncated, info["is_success"]) == (0.0, False, False, False)
    _, reward, terminated, _, info = env.step(NORTH)
    assert terminated and reward == 1.0 and info["is_success"] and info["decisions"] == 3.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"movement": "magic"}, "movement = 'magic' must be one of oracle, full"),
        ({"knows": "map"}, "knows = 'map' needs a map"),
        ({"knows": "all"}, "knows = 'all' must be one of nothing, goal, map"),
        ({"pixels": 1000}, "view pixels = 1000 must be at least 3"),
        ({"reward": "shaped"}, "reward = 'shaped' must be one of"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(base.UserError, match=message):
        HighLevelEnv(robot="point", **options)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (4, r"action \[4\] must be from 0 to 3"),
        (0.5, "action of type float64 must be whole numbers"),
        (np.nan, "action of type float64 must be whole numbers"),
        ([1], r"action of shape \(1,\) must have shape \(\)"),
    ],
)
def test_bad_decisions_are_named(action, message):
    env = HighLevelEnv(robot="point")
    env.reset(seed=0)
    with pytest.raises(base.UserError, match=message):
        env.step(action)
