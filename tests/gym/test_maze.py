"""Our mazes through Gymnasium's eyes: its own checker, goals, ends of episodes, bad input."""

import copy
import os
import pathlib
import pickle
import subprocess
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils import env_checker
from gymnasium.wrappers import vector as wrappers

import eihrl_jax.gym
from eihrl_jax import base, mazes, robots
from eihrl_jax.drawing import palette
from eihrl_jax.envs import goal_maze
from eihrl_jax.gym import MazeEnv, MazeVectorEnv
from eihrl_jax.physics import engines

K = robots.load("point").steps_per_subgoal
MODES = ("SameStep", "NextStep", "Disabled")
STILL = np.zeros(2, np.float32)


def small(**options):
    """A point in the maze U, where programs are shared by all tests that ask for the same."""
    return MazeEnv("u", "point", num_decisions=2, **options)


@pytest.mark.parametrize(
    "options", [{}, {"observation": "goal"}, {"observation": "goal", "reward": "dense"}]
)
def test_gymnasium_finds_nothing_wrong(options):
    env_checker.check_env(small(**options), skip_render_check=True)


def test_ids_are_there_for_every_robot_and_maze_of_the_paper():
    ids = [name for name in gymnasium.registry if name.startswith("eihrl_jax/")]
    assert len(ids) == len(robots.NAMES) * len(mazes.NAMES) + 2
    env = gymnasium.make("eihrl_jax.gym:eihrl_jax/Humanoid-G1-v0").unwrapped
    assert isinstance(env, MazeEnv) and env.action_space.shape == (17,)
    envs = gymnasium.make_vec(eihrl_jax.gym.MAZE_ID, 2, maze="s", robot="point")
    assert isinstance(envs, MazeVectorEnv) and envs.num_envs == 2


def test_the_same_seed_is_the_same_trajectory_as_in_the_bare_environment():
    maze = mazes.load("u", num_decisions=2)
    bare = goal_maze.GoalMaze(engines.make(robots.load("point"), "mujoco"), maze)
    state = jax.jit(jax.vmap(bare.reset))(jax.vmap(jax.random.key)(jnp.array([7, 8])))
    step = jax.jit(jax.vmap(bare.step))

    envs, env = MazeVectorEnv(2, "u", "point", num_decisions=2), small()
    many, _ = envs.reset(seed=7)
    one, _ = env.reset(seed=8)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 2, 2)).astype(np.float32):
        xy = np.asarray(state.obs.xy) - [13.5, -13.5]
        np.testing.assert_allclose(many[:, :2], xy, atol=1e-5)
        np.testing.assert_allclose(one[:2], xy[1], atol=1e-5)
        state = step(state, action)
        many, one = envs.step(action)[0], env.step(action[1])[0]


def test_an_observation_is_told_from_the_mazes_centre():
    obs = base.GoalObs(
        xy=jnp.array([10.0, -4.0]),
        proprioception=jnp.array([0.5, 0.25]),
        goal_xy=jnp.array([2.0, -16.0]),
        time=jnp.float32(0.1),
    )
    see = small()._rows.task.see
    np.testing.assert_allclose(see(obs), [-3.5, 9.5, 0.5, 0.25, -11.5, -2.5, 0.1])


def test_a_goal_is_reached_and_paid_as_compute_reward_says():
    env = small(observation="goal")
    env.reset(seed=0, options={"start_cell": (6, 2), "goal_cell": (5, 2)})
    paid = 0.0
    while not paid:
        obs, paid, terminated, truncated, info = env.step(np.array([0.0, 1.0]))
        goals = obs["achieved_goal"], obs["desired_goal"]
        assert paid == env.compute_reward(*goals, info) == float(terminated)
        assert not truncated and obs in env.observation_space
    assert info["is_success"] and info["success"] == 1.0

    # In the region of U's goal any cell is as good as another; elsewhere none is.
    first, same, other = [-9.0, 10.0], [-6.0, 4.0], [-3.0, 4.0]
    rewards = env.compute_reward(np.array([first, first]), np.array([same, other]), [{}, {}])
    assert rewards.tolist() == [1.0, 0.0] and not hasattr(small(), "compute_reward")


def test_what_a_reset_leaves_open_is_drawn():
    env = MazeEnv("random", "point", num_decisions=2)
    goals = {tuple(env.reset(seed=s, options={"start_cell": (2, 3)})[0][-3:-1]) for s in range(4)}
    assert len(goals) > 1
    starts = [env.reset(seed=s, options={"goal_cell": (0, 4)})[0] for s in range(4)]
    assert len({tuple(obs[:2]) for obs in starts}) == 4
    assert {tuple(obs[-3:-1]) for obs in starts} == {(0.0, 12.0)}


def test_rows_may_have_places_of_their_own():
    envs = MazeVectorEnv(2, "u", "point", num_decisions=2)
    obs, _ = envs.reset(seed=0, options={"start_cell": [(6, 2), (5, 6)], "goal_cell": (4, 6)})
    np.testing.assert_allclose(obs[:, :2], [[-6, -6], [6, -3]], atol=0.5)
    np.testing.assert_array_equal(obs[:, -3:-1], [[6, 0], [6, 0]])


def test_gymnasiums_own_vectors_and_wrappers_see_the_same():
    options = {"maze": "u", "robot": "point", "num_decisions": 2}
    made = [
        wrappers.NormalizeReward(wrappers.RecordEpisodeStatistics(envs))
        for mode in ("sync", "vector_entry_point")
        for envs in [gymnasium.make_vec(eihrl_jax.gym.MAZE_ID, 2, mode, **options)]
    ]
    for envs in made:
        envs.reset(seed=5)
    # Beyond an end, and the step that begins the next episode.
    for _ in range(2 * K + 2):
        one, other = (envs.step(np.ones((2, 2), np.float32)) for envs in made)
        for mine, theirs in zip(one[:4], other[:4], strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-4)
    np.testing.assert_allclose(one[0][:, -1], 0.001)


@pytest.mark.parametrize("mode", MODES)
def test_what_follows_the_end_of_an_episode(mode):
    envs = MazeVectorEnv(2, "u", "point", num_decisions=2, autoreset_mode=mode)
    envs.reset(seed=2)
    still = np.stack([STILL, STILL])
    *_, before, (obs, _, terminated, truncated, info) = [envs.step(still) for _ in range(2 * K)]
    assert "final_obs" not in before[-1] and not before[3].any()
    assert truncated.all() and not terminated.any()

    last = obs if mode != "SameStep" else info["final_obs"]
    np.testing.assert_allclose(last[:, -1] * base.TIME_UNIT, 2 * K, rtol=1e-6)
    if mode == "SameStep":
        assert info["_final_obs"].all() and (info["final_info"]["steps"] == 2 * K).all()
    elif mode == "NextStep":
        obs, reward, _, truncated, _ = envs.step(still)
        assert not reward.any() and not truncated.any()
    else:
        resting, *_ = envs.step(still)
        np.testing.assert_array_equal(resting, obs)
        one, _ = envs.reset(options={"reset_mask": np.array([True, False])})
        np.testing.assert_array_equal(one[1], resting[1])
        obs, _ = envs.reset(options={"reset_mask": np.array([False, True])})
        np.testing.assert_array_equal(one[0], obs[0])

    # The second episode of a row is the same in every mode, and that of an environment alone.
    env = small()
    env.reset(seed=3)
    np.testing.assert_array_equal(obs[1], env.reset()[0])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_the_original_would(duplicate):
    env = small()
    obs, _ = env.reset(seed=1)
    obs[:] = 0.0  # what is returned may be written to
    other = duplicate(env)
    for _ in range(3):
        np.testing.assert_array_equal(env.step(STILL + 1)[0], other.step(STILL + 1)[0])
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])
    with pytest.raises(base.UserError, match="step was called before reset"):
        duplicate(small()).step(STILL)


def test_pictures_show_the_robot_the_goal_and_whether_it_is_reached():
    env = small(render_mode="rgb_array")
    with pytest.raises(base.UserError, match="render was called before reset"):
        env.render()
    env.reset(seed=0, options={"start_cell": (6, 2), "goal_cell": (5, 2)})
    before = env.render()
    assert before.shape == (480, 480, 3) and before.dtype == np.uint8
    for _ in range(12):
        env.step(np.array([0.0, 1.0]))
    after = copy.deepcopy(env).render()

    # As many pixels of each colour as there are before and after, in any light.
    def num_pixels(colour):
        near = [np.abs(picture / 255.0 - colour).max(-1) < 0.2 for picture in (before, after)]
        return [int(is_near.sum()) for is_near in near]

    goal, achieved = (
        num_pixels(palette.rgb(palette.GOAL)),
        num_pixels(palette.rgb(palette.GOAL_ACHIEVED)),
    )
    assert goal[0] > goal[1] + 1000 and achieved[1] > achieved[0] + 1000
    assert (before != after).any(-1).sum() > 1000
    assert small().render() is None


WORKERS = """
import sys, warnings
import gymnasium, jax, eihrl_jax.gym

def make(context):
    kwargs = {"context": context}
    return gymnasium.make_vec("eihrl_jax/Point-U-v0", 2, "async", vector_kwargs=kwargs)

if __name__ == "__main__":
    context = sys.argv[1]
    warnings.simplefilter("error")
    envs = make(context)
    print(envs.reset(seed=0)[0].shape, envs.step(envs.action_space.sample())[0].shape)
    envs.close()
    if context == "fork":
        jax.random.key(0)
        warnings.simplefilter("ignore")
        make(context).reset()
"""


@pytest.mark.parametrize(
    "context",
    ["fork", *(pytest.param(name, marks=pytest.mark.slow) for name in ("spawn", "forkserver"))],
)
def test_worker_processes_step_or_say_why_not(context, tmp_path):
    script = tmp_path / "workers.py"
    script.write_text(WORKERS)
    done = subprocess.run(
        [sys.executable, script, context],
        env={**os.environ, "PYTHONPATH": str(pathlib.Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "(2, 7) (2, 7)" in done.stdout, done.stderr
    is_told = "forked from one in which JAX was running" in done.stderr
    assert is_told == (context == "fork"), done.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "shaped"}, "reward = 'shaped' must be one of sparse, dense"),
        ({"maze": "nowhere"}, "maze 'nowhere': neither a file nor one of"),
        ({"robot": "dog"}, "robot 'dog' is unknown"),
        ({"engine": "bullet"}, "engine = 'bullet' must be one of mujoco, mjx"),
        ({"observation": "image"}, "observation = 'image' must be one of flat, goal"),
        ({"maze": "s", "observation": "goal"}, "for mazes of one goal, this one has 3"),
        ({"num_decisions": 2**31 - 1}, "num_decisions = 2147483647 must be at least 1 and at most"),
        ({"num_decisions": True}, "num_decisions = True must be a whole number"),
        ({"render_mode": "human"}, "render_mode = 'human' must be one of rgb_array"),
        ({"num_envs": 0}, "num_envs = 0 must be at least 1"),
        ({"autoreset_mode": "Never"}, "autoreset_mode = 'Never' must be one of NextStep"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(base.UserError, match=message):
        MazeVectorEnv(**{"maze": "u", "robot": "point", **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("x", "options = 'x' must be a dict of start_cell, goal_cell"),
        ({"reset_mask": np.ones(1, bool)}, "options: 'reset_mask' is unknown"),
        ({"start_cell": (0, 1)}, r"start_cell = \[0, 1\] is in a wall"),
        ({"goal_cell": (4, 4)}, r"goal_cell = \[4, 4\] is in a wall"),
        ({"start_cell": (1, 9)}, r"start_cell = \[1, 9\] is outside the 9 x 9 cells"),
        ({"start_cell": (-1, 1)}, r"start_cell = \[-1, 1\] is outside"),
        ({"start_cell": 3}, "start_cell = 3 must be a row and a column"),
        ({"start_cell": (1.0, 2.0)}, r"start_cell = \(1.0, 2.0\) must be a row and a column"),
        ({"start_cell": (1, 1)}, r"start_cell = \[1, 1\] is at the goal"),
        ({"goal_cell": (6, 1)}, "no start of the maze is left"),
    ],
)
def test_bad_resets_are_named(options, message):
    with pytest.raises(base.UserError, match=message):
        small().reset(options=options)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(1), r"action of shape \(1,\) must have shape \(2,\)"),
        (np.zeros((2, 1)), r"action of shape \(2, 1\) must have shape \(2,\)"),
        (np.zeros(3), r"action of shape \(3,\) must have shape \(2,\)"),
        (["a", "b"], "action of type <U1 must be numbers"),
        ([0.0, np.nan], r"action\[1\] = nan must be a finite number"),
        ([-np.inf, 0.0], r"action\[0\] = -inf must be a finite number"),
        ([1e300, 0.0], r"action\[0\] = inf must be a finite number"),
    ],
)
def test_bad_actions_are_named(action, message):
    env = small()
    env.reset(seed=0)
    with pytest.raises(base.UserError, match=message):
        env.step(action)


def test_too_strong_an_action_is_the_strongest():
    env, other = small(), small()
    for each in (env, other):
        each.reset(seed=0)
    np.testing.assert_array_equal(env.step([9.0, -1.5])[0], other.step([1.0, -1.0])[0])


def test_an_action_of_a_row_that_is_not_finite_is_named():
    envs = MazeVectorEnv(2, "u", "point", num_decisions=2, observation="goal")
    envs.reset(seed=0)
    with pytest.raises(base.UserError, match=r"action\[1, 0\] = nan must be a finite number"):
        envs.step(np.array([[0.0, 0.0], [np.nan, 0.0]]))


def test_bad_masks_and_seeds_are_named():
    envs = MazeVectorEnv(2, "u", "point", num_decisions=2)
    with pytest.raises(base.UserError, match="the other rows have begun no episode"):
        envs.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(base.UserError, match=r"reset_mask = \[True\] must be a bool array of 2"):
        envs.reset(options={"reset_mask": [True]})
    with pytest.raises(base.UserError, match="seed: 3 of them for 2 rows"):
        envs.reset(seed=[1, 2, 3])
