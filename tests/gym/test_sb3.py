"""Stable-Baselines3 trains on our robots in parallel, where it is installed."""

import numpy as np
import pytest

stable_baselines3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common import env_checker, vec_env  # noqa: E402

from eihrl_jax import base  # noqa: E402
from eihrl_jax.gym import MazeEnv, MazeVectorEnv, sb3  # noqa: E402


def parallel(num_decisions=1, **options):
    options = {"autoreset_mode": "SameStep", "num_decisions": num_decisions, **options}
    return MazeVectorEnv(3, "u", "point", **options)


@pytest.mark.parametrize("observation", ["flat", "goal"])
def test_its_checker_finds_nothing_wrong(observation):
    env_checker.check_env(MazeEnv("u", "point", num_decisions=1, observation=observation))


def test_the_end_of_an_episode_is_told_as_it_wants_it():
    envs = sb3.VecEnv(parallel())
    envs.seed(0)
    envs.set_options({"start_cell": (6, 2)})
    begun = envs.reset()
    np.testing.assert_allclose(begun[:, :2], [[-6.0, -6.0]] * 3, atol=0.5)
    *_, (obs, _, done, infos) = [envs.step(np.zeros((3, 2))) for _ in range(25)]
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)
    assert infos[0]["terminal_observation"][-1] == pytest.approx(0.025) and obs[0, -1] == 0.0
    assert infos[0]["is_success"] is False and infos[0]["steps"] == 25.0
    assert not np.array_equal(obs, begun)


def test_learners_learn():
    # Statistics of episodes are those of its own wrapper.
    envs = vec_env.VecMonitor(sb3.VecEnv(parallel()))
    stable_baselines3.PPO("MlpPolicy", envs, n_steps=32, batch_size=32).learn(96)
    model = stable_baselines3.SAC(
        "MultiInputPolicy",
        sb3.VecEnv(parallel(observation="goal")),
        replay_buffer_class=stable_baselines3.HerReplayBuffer,
        learning_starts=90,
        batch_size=8,
    )
    model.learn(120)
    assert model.num_timesteps == 120 and len(model.ep_success_buffer) == 3


def test_another_mode_is_refused():
    with pytest.raises(base.UserError, match="autoreset_mode = 'NextStep' must be SameStep"):
        sb3.VecEnv(parallel(autoreset_mode="NextStep"))
