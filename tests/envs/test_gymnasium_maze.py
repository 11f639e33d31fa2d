"""Our mazes through Gymnasium's eyes: its own checker, ends of episodes, bad input."""

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils import env_checker

from eihrl_jax import base, robots
from eihrl_jax.envs import gymnasium_maze

K = robots.load("point").steps_per_subgoal


@pytest.fixture(scope="module")
def env():
    return gymnasium_maze.MazeEnv("s", "point", num_decisions=2)


@pytest.fixture(scope="module")
def envs():
    return gymnasium_maze.MazeVectorEnv(3, "s", "point", num_decisions=2)


@pytest.mark.filterwarnings("ignore:.*A Box observation space")
def test_gymnasium_finds_nothing_wrong(env):
    env_checker.check_env(env, skip_render_check=True)


def test_an_observation_is_told_from_the_mazes_centre():
    obs = base.GoalObs(
        xy=jnp.array([10.0, -4.0]),
        proprioception=jnp.array([0.5, 0.25]),
        goal_xy=jnp.array([2.0, -16.0]),
        time=jnp.float32(0.1),
    )
    found = gymnasium_maze.features(obs, (20, 30))
    np.testing.assert_allclose(found, [0.0, 11.0, 0.5, 0.25, -8.0, -1.0, 0.1])


def test_an_episode_is_cut_at_its_limit(env):
    env.reset(seed=1)
    still = np.zeros(env.action_space.shape, np.float32)
    steps = [env.step(still) for _ in range(2 * K)]
    assert [truncated for *_, truncated, _ in steps] == [False] * (2 * K - 1) + [True]
    assert not any(terminated for _, _, terminated, _, _ in steps)
    obs, *_, info = steps[-1]
    assert obs[-1] * base.TIME_UNIT == pytest.approx(2 * K) == info["steps"]


def test_a_seed_fixes_all_episodes_that_follow(env):
    first = [env.reset(seed=3)[0], env.reset()[0]]
    again = [env.reset(seed=3)[0], env.reset()[0]]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(*first)


def test_rows_begin_anew_and_tell_how_the_old_episode_ended(envs):
    begun, _ = envs.reset(seed=2)
    assert begun.shape == envs.observation_space.shape and envs.observation_space.contains(begun)
    assert len(np.unique(begun, axis=0)) == 3
    still = np.zeros(envs.action_space.shape, np.float32)
    *_, before = [envs.step(still) for _ in range(2 * K - 1)]
    assert "final_obs" not in before[-1]
    obs, _, terminated, truncated, info = envs.step(still)
    assert truncated.all() and not terminated.any() and info["_final_obs"].all()
    np.testing.assert_allclose(info["final_obs"][:, -1] * base.TIME_UNIT, 2 * K, rtol=1e-6)
    np.testing.assert_array_equal(info["final_info"]["steps"], np.full(3, 2.0 * K))
    np.testing.assert_array_equal(obs[:, -1], np.zeros(3))


def test_dense_reward_is_nearness():
    env = gymnasium_maze.MazeEnv("u", "point", reward="dense")
    env.reset(seed=0)
    obs, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    distance = np.linalg.norm(obs[-3:-1] - obs[:2])
    assert reward == pytest.approx(1.0 / (1.0 + distance), rel=1e-5)


def test_registered_both_are_made_by_name():
    gymnasium_maze.register()
    try:
        one = gymnasium.make(gymnasium_maze.ID, maze="u", robot="point")
        many = gymnasium.make_vec(gymnasium_maze.ID, num_envs=2, maze="u", robot="point")
        assert isinstance(one.unwrapped, gymnasium_maze.MazeEnv)
        assert isinstance(many, gymnasium_maze.MazeVectorEnv) and many.num_envs == 2
    finally:
        gymnasium.registry.pop(gymnasium_maze.ID)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "shaped"}, "reward 'shaped' is unknown; choose one of sparse, dense"),
        ({"maze": "nowhere"}, "maze 'nowhere': neither a file nor one of"),
        ({"engine": "bullet"}, "engine 'bullet' is unknown"),
    ],
)
def test_bad_input_is_named(options, message):
    with pytest.raises(base.UserError, match=message):
        gymnasium_maze.MazeEnv(**{"robot": "point", **options})


def test_what_isnt_ready_says_so():
    with pytest.raises(base.UserError, match="num_envs = 0 is below 1"):
        gymnasium_maze.MazeVectorEnv(0)
    with pytest.raises(base.UserError, match="step was called before reset"):
        gymnasium_maze.MazeEnv("u", "point").step(np.zeros(2, np.float32))
