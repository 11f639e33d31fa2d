"""The low level's trainer: it runs, resumes exactly, exports, and refuses what doesn't fit."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import postures
from eihrl_jax.runs import checkpoint, policies
from eihrl_jax.training import low, low_trainer


def _config(run, **changes):
    options = {
        "num_envs": 8,
        "num_iterations": 12,
        "warmup_iterations": 4,
        "updates_per_iteration": 2,
        "capacity": 256,
        "num_rooms": 4,
        "droq": low_config.Droq(hidden=(16, 16), actor_period=2, batch_size=16),
        "log_every": 3,
        "evaluate_every": 3,
        "checkpoint_every": 6,
        "num_postures": 32,
    }
    return dataclasses.replace(presets.low_point(), run=run, **(options | changes))


@pytest.fixture(scope="module")
def trainer(tmp_path_factory):
    """Compiled for one run, it serves others."""
    return low_trainer.LowTrainer(_config(tmp_path_factory.mktemp("low") / "whole"))


@pytest.fixture(scope="module")
def whole_run(trainer):
    low.train_with(trainer, trainer.config)
    return trainer.config


def test_run_leaves_policy_statistics_and_postures(whole_run):
    params, meta = policies.load(policies.find(whole_run.run, "low"), kind="low", robot="point")
    assert params["Dense_0"]["kernel"].shape == (meta["num_features"], 16)
    assert meta["num_iterations"] == 12 and meta["num_updates"] == 24
    assert {"along_mean", "along_std", "lateral_std", "falls"} <= set(meta["statistics"])
    bank = postures.load(whole_run.run / "postures.npz", robots.load("point"))
    assert bank.qpos.shape == (32, 2) and not np.asarray(bank.qpos).any()
    rows = (whole_run.run / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", "3", "6", "9", "12"]
    assert json.loads((whole_run.run / "config.json").read_text())["robot"] == "point"


def test_resuming_changes_nothing(trainer, whole_run, tmp_path):
    """As after a kill between the last row and its checkpoint."""
    run = shutil.copytree(whole_run.run, tmp_path / "killed")
    shutil.rmtree(run / policies.FOLDER)
    shutil.rmtree(run / "checkpoints" / f"{12:012d}")
    low.train_with(trainer, _config(run, resume=True))
    template = jax.eval_shape(trainer.init, jax.random.key(0))
    states = [
        checkpoint.restore(path / "checkpoints", template)[1] for path in (whole_run.run, run)
    ]
    for left, right in zip(*map(jax.tree.leaves, states), strict=True):
        if jax.dtypes.issubdtype(left.dtype, jax.dtypes.prng_key):
            left, right = jax.random.key_data(left), jax.random.key_data(right)
        np.testing.assert_array_equal(left, right)
    files = [(path / "metrics.csv").read_text() for path in (whole_run.run, run)]
    assert files[0] == files[1]


def test_starting_from_another_run_goes_on_learning(trainer, whole_run, tmp_path):
    """Under another reward: the learner's count and its replay go on, the iterations begin anew.

    Once begun, the run goes on without the other, and with other intervals.
    """
    start = shutil.copytree(whole_run.run, tmp_path / "start")
    config = _config(tmp_path / "second", start_from=start, num_iterations=6)
    low.train_with(trainer, config)
    shutil.rmtree(start)
    config = dataclasses.replace(config, num_iterations=12, checkpoint_every=3, resume=True)
    low.train_with(trainer, config)
    template = jax.eval_shape(trainer.init, jax.random.key(0))
    step, state = checkpoint.restore(config.run / "checkpoints", template)
    assert (step, int(state.iteration), int(state.learner.num_updates)) == (12, 12, 48)
    assert int(state.replay.size) == 8 * (4 + 12 + 12)
    # The reward isn't stored, so a run under another one can begin with the same state.
    reward = low_config.LowReward(is_paced=True, beyond_cell=-1.0)
    other = low_trainer.LowTrainer(dataclasses.replace(config, reward=reward))
    assert checkpoint.restore(
        whole_run.run / "checkpoints", jax.eval_shape(other.init, jax.random.key(0))
    )


def test_start_that_does_not_fit_is_refused(whole_run, tmp_path):
    with pytest.raises(base.UserError, match="holds no checkpoint"):
        low.train(_config(tmp_path / "first", start_from=tmp_path))
    assert not (tmp_path / "first").exists()
    droq = dataclasses.replace(whole_run.droq, hidden=(8, 8))
    with pytest.raises(base.UserError, match="Dense_0"):
        low.train(_config(tmp_path / "second", start_from=whole_run.run, droq=droq))


def test_start_from_a_robot_that_has_changed_is_refused(whole_run, tmp_path):
    config = _config(tmp_path / "third", start_from=whole_run.run)
    trainer = low_trainer.LowTrainer(config)
    trainer.fingerprint = "of a heavier point"
    with pytest.raises(base.UserError, match="another version of robot 'point'"):
        low.train_with(trainer, config)
    assert not config.run.exists()


def test_other_options_are_refused_on_resume(whole_run):
    other = dataclasses.replace(whole_run, resume=True, seed=1)
    with pytest.raises(base.UserError, match="seed = 0 and can't go on with 1"):
        low.train(other)


@pytest.mark.parametrize("preset", presets.LOW.values(), ids=lambda preset: preset.preset)
def test_presets_build(preset):
    trainer = low_trainer.LowTrainer(
        dataclasses.replace(preset, num_rooms=min(preset.num_rooms, 2))
    )
    sizes = {"best": 30, "paper": 35, "point": 5, "swimmer": 12, "humanoid": 48, "stand": 31}
    assert trainer.num_features == sizes[preset.preset]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0 must be at least 1"),
        ({"capacity": 100}, "num_envs = 8 must divide capacity = 100"),
        ({"log_every": 5}, "log_every = 5 must divide num_iterations = 12"),
        ({"robot": "dog"}, "robot 'dog' is unknown"),
        (
            {"reward": low_config.LowReward(fall_cost=2.0), "ends_at_fall": False},
            "fall_cost = 2.0 .* must be 0 with",
        ),
    ],
)
def test_bad_options_are_named(tmp_path, change, message):
    with pytest.raises(base.UserError, match=message):
        low_trainer.LowTrainer(_config(tmp_path / "run", **change))
