"""Datasets: episodes are those of the Gymnasium environments, on disk whole, in Minari's form."""

import dataclasses
import pathlib
import re
from typing import Any

import numpy as np
import pytest

from eihrl_jax import base, datasets
from eihrl_jax.config.dataset import DatasetConfig
from eihrl_jax.datasets import making, parts

WALKING = DatasetConfig(robot="point", num_decisions=3, episodes=3, batch=2, seed=7)
ORACLE = dataclasses.replace(WALKING, movement="oracle", reward="dense", num_decisions=4)


@pytest.fixture(scope="module", params=[WALKING, ORACLE], ids=["walking", "oracle"])
def recorded(request):
    made = making.make(request.param)
    return made.env, parts.Rows(made.recorder, 2).run(7)


def test_episodes_are_those_of_the_gymnasium_environment(recorded):
    env, episodes = recorded
    for seed, episode in enumerate(episodes, start=7):
        obs, _ = env.reset(seed=seed)
        steps = zip(
            episode["actions"],
            episode["rewards"],
            episode["terminations"],
            episode["truncations"],
            episode["observations"][1:],
            strict=True,
        )
        np.testing.assert_allclose(episode["observations"][0], obs, atol=1e-4)
        for i, (action, reward, terminated, truncated, after) in enumerate(steps):
            obs, *outcome, _ = env.step(action)
            np.testing.assert_allclose(after, obs, atol=1e-4, err_msg=f"seed {seed}, step {i}")
            np.testing.assert_allclose(outcome, [reward, terminated, truncated], atol=1e-6)
        assert terminated or truncated

        # Told once more than there are steps, and what moved is where it was seen.
        infos = parts.nested(episode)["infos"]
        num = len(episode["rewards"])
        assert {len(each) for each in infos.values()} == {num + 1}
        assert set(infos["direction"]) <= set(range(base.NUM_DIRECTIONS))
        if "qpos" in infos:
            own = infos["qpos"] - [13.5, -13.5]
            np.testing.assert_allclose(episode["observations"][:, :2], own, atol=1e-5)
        else:
            np.testing.assert_array_equal(infos["direction"][:-1], episode["actions"])


def test_parts_hold_what_was_told(tmp_path):
    episodes = [
        {
            "observations": np.random.default_rng(num).normal(size=(num + 1, 2)),
            "infos/qpos": np.arange(num + 1.0),
            "rewards": np.full(num, 0.5, np.float32),
        }
        for num in (3, 1, 2)
    ]
    path = tmp_path / "part.npz"
    parts.write(path, episodes, 7)
    for before, after in zip(episodes, parts.read(path, 7), strict=True):
        assert before.keys() == after.keys()
        for name, array in before.items():
            np.testing.assert_array_equal(array, after[name])

    with pytest.raises(base.UserError, match=r"part\.npz has the episodes of seed 7, not 9"):
        list(parts.read(path, 9))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(base.UserError, match=r"part\.npz is damaged; remove it"):
        list(parts.read(path, 7))


def test_what_does_not_fit_is_one_line(monkeypatch):
    with pytest.raises(base.UserError, match="low = point needs movement full"):
        dataclasses.replace(ORACLE, low="point")
    with pytest.raises(base.UserError, match="observation = 'goal' needs movement full"):
        dataclasses.replace(ORACLE, observation="goal")
    monkeypatch.setattr(datasets, "_NEEDED", ("numpy", "minary"))
    with pytest.raises(base.UserError, match="dataset needs minary, which isn't there: pip"):
        datasets.check_installed()


def test_minari_reads_what_a_killed_run_goes_on_with(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    from eihrl_jax.datasets import dataset

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    config = dataclasses.replace(WALKING, observation="goal", num_decisions=2)
    run = parts.Rows.run

    def stopped(rows, first_seed):
        if first_seed > config.seed:
            raise KeyboardInterrupt
        return run(rows, first_seed)

    monkeypatch.setattr(parts.Rows, "run", stopped)
    with pytest.raises(base.Stopped, match="keeps 2 of 3 episodes"):
        dataset.write(config)
    with pytest.raises(base.UserError, match="unfinished"):
        dataset.write(config)
    with pytest.raises(base.UserError, match="reward = 'sparse' and can't go on with 'dense'"):
        dataset.write(dataclasses.replace(config, resume=True, reward="dense"))

    seeds = []
    monkeypatch.setattr(parts.Rows, "run", lambda rows, seed: seeds.append(seed) or run(rows, seed))
    path = dataset.write(dataclasses.replace(config, resume=True))
    assert seeds == [config.seed + 2]  # the first part was there

    name = "eihrl_jax/point-u/walking-v0"
    assert path == tmp_path / name and list(minari.list_local_datasets()) == [name]
    text = (pathlib.Path(__file__).parents[2] / "docs" / "datasets.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    shown: dict[str, Any] = {}
    exec(example.replace("ant-u", "point-u"), shown)
    loaded = shown["dataset"]
    assert loaded.total_episodes == 3 and loaded.spec.total_steps == 3 * 50
    for i, episode in enumerate(loaded.iterate_episodes()):
        assert len(episode.observations["achieved_goal"]) == len(episode.infos["qpos"]) == 51
        assert episode.truncations[-1] and not episode.truncations[:-1].any()
        assert next(iter(loaded.storage.get_episode_metadata([i])))["seed"] == config.seed + i
    obs, _ = shown["env"].unwrapped.reset(seed=config.seed)
    first = shown["episode"].observations
    np.testing.assert_allclose(first["observation"][0], obs["observation"], atol=1e-5)

    # Never in place of another one, finished or not.
    with pytest.raises(base.UserError, match="is there already, .*; give another --name"):
        dataset.write(dataclasses.replace(config, resume=True))
    for bad in ("no-version", "../up-v0", ""):
        with pytest.raises(base.UserError, match="must be like eihrl_jax/ant-u/walking-v0"):
            dataset.write(dataclasses.replace(config, name=bad))
