"""The training loop of the high level: run folder, resume, policy, bad options."""

import dataclasses
import json
import math
import shutil

import jax
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import codec, presets
from eihrl_jax.config import high as high_config
from eihrl_jax.envs import postures, subgoals
from eihrl_jax.runs import policies
from eihrl_jax.training import high


def tiny(run, **options):
    """Returns a run of a few updates."""
    task = high_config.Task(robot="point")
    network = high_config.Network(tile_features=2, hidden=(4,))
    learner = high_config.Learner(num_workers=8, window=12, num_updates=6, optimiser="adam")
    intervals = {"log_every": 2, "evaluate_every": 4, "num_eval_episodes": 4, "checkpoint_every": 2}
    return high_config.HighConfig(
        run=run, task=task, network=network, learner=learner, **intervals | options
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Returns the folder of a finished run."""
    path = tmp_path_factory.mktemp("high") / "run"
    high.train(tiny(path))
    return path


def test_run_folder_has_metrics_and_a_policy(finished):
    lines = (finished / "metrics.csv").read_text().splitlines()
    header, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    table = {name: [row[i] for row in rows] for i, name in enumerate(header)}
    assert table["step"] == ["2", "4", "6"]
    assert table["num_decisions"] == ["192.0", "384.0", "576.0"]
    assert table["eval/success"][0] == "" and 0.0 <= float(table["eval/success"][2]) <= 1.0
    params, meta = policies.load(policies.find(finished, "high"), kind="high")
    view = {"extent": 9.0, "pixels": 15, "map_radius": 0, "map_shape": None, "knows": "nothing"}
    assert meta["view"] == view
    assert meta["network"] == json.loads(codec.to_json(tiny(finished).network))
    assert meta["num_updates"] == 6 and meta["num_decisions"] == 576
    assert params["params"]["logits"]["kernel"].shape == (4, 4)


def test_resumed_run_equals_the_uninterrupted_one(finished, tmp_path):
    resumed = tmp_path / "resumed"
    shutil.copytree(finished, resumed)
    shutil.rmtree(resumed / policies.FOLDER)
    shutil.rmtree(resumed / "checkpoints" / f"{6:012d}")
    high.train(tiny(resumed, resume=True))
    assert (resumed / "metrics.csv").read_text() == (finished / "metrics.csv").read_text()
    left, right = (
        policies.load(path / policies.FOLDER, kind="high")[0] for path in (resumed, finished)
    )
    jax.tree.map(np.testing.assert_array_equal, left, right)


def test_summary_divides_by_episodes_or_by_updates():
    metrics = {
        "decisions": np.array([16.0, 16.0]),
        "episodes": np.array([1.0, 3.0]),
        "sum_success": np.array([1.0, 1.0]),
        "entropy": np.array([1.0, 0.5]),
    }
    assert high.summarise(metrics) == {"success": 0.5, "entropy": 0.75}
    none = metrics | {"episodes": np.zeros(2), "sum_success": np.zeros(2)}
    assert np.isnan(high.summarise(none)["success"])


@pytest.mark.parametrize("name", presets.HIGH)
def test_presets_build_and_come_back_from_json(name):
    preset = presets.HIGH[name]
    assert preset.preset == name
    text = codec.to_json(preset)
    assert codec.from_json(high_config.HighConfig, text) == preset
    assert json.loads(text)["learner"]["window"] == preset.learner.window


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 25}, "window = 25 must be at least 1 and at most 24"),
        ({"num_updates": 30_000_000}, "num_updates = 30000000 must be .* at most 22369621"),
    ],
)
def test_learner_that_does_not_fit_the_maze(tmp_path, options, message):
    config = tiny(tmp_path)
    learner = dataclasses.replace(config.learner, **options)
    with pytest.raises(base.UserError, match=message):
        high.make_agent(high.make_env(config.task), dataclasses.replace(config, learner=learner))


def test_whole_episodes_last_as_long_as_the_largest_room_allows(tmp_path):
    config = tiny(tmp_path)
    task = dataclasses.replace(config.task, num_rooms=6)
    learner = dataclasses.replace(config.learner, window=None)
    env = high.make_env(task)
    limits = env.table.mazes.num_decisions
    assert limits.min() < limits.max()
    assert (
        high.make_agent(env, dataclasses.replace(config, learner=learner)).horizon == limits.max()
    )


@pytest.mark.parametrize("reward", ["sparse", "dense"])
def test_values_look_beyond_the_limit_where_the_reward_is_dense(tmp_path, reward):
    config = tiny(tmp_path)
    config = dataclasses.replace(config, task=dataclasses.replace(config.task, reward=reward))
    agent = high.make_agent(high.make_env(config.task), config)
    assert agent.learner.looks_beyond_limit == (reward == "dense")


@pytest.mark.parametrize(
    ("part", "options", "message"),
    [
        (high_config.Learner, {"gamma": 1.5}, "gamma = 1.5"),
        (high_config.Learner, {"num_workers": 0}, "num_workers = 0"),
        (high_config.Learner, {"optimiser": "sgd"}, "optimiser = 'sgd'"),
        (
            high_config.Task,
            {"room_sides": (7, 6)},
            "room_sides = 7 must be at least 2 and at most 6",
        ),
        (high_config.Task, {"maze": "u", "num_rooms": 9}, "num_rooms = 9 exclude each other"),
        (high_config.HighConfig, {"log_every": 7}, "log_every = 7 must divide num_updates"),
        (high_config.HighConfig, {"network": high_config.Network(tile=4)}, "tile = 4 must divide"),
        (
            high_config.HighConfig,
            {"network": high_config.Network(kind="search")},
            "a patch takes no map, search needs one",
        ),
    ],
)
def test_options_out_of_range(part, options, message):
    with pytest.raises(base.UserError, match=message):
        part(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma": -0.1}, r"sigma = -0\.1 must be at least 0\.0"),
        ({"step": 20.0}, r"step = 20\.0 must be at least 0\.0 and at most 12\.0"),
        ({"extent": 60.0}, r"extent = 60\.0 must be at least 3\.0 and at most 45\.0"),
        ({"pixels": 200}, "pixels = 200 must be at least 3 and at most 128"),
        ({"map_radius": 301}, "map_radius = 301 must be at least 0 and at most 300"),
        (
            {"num_rooms": 4, "room_walls": 0.5},
            r"wall_share = 0\.5 must be at least 0\.0 and at most 0\.4",
        ),
    ],
)
def test_limits_of_view_movement_and_rooms_are_told(options, message):
    with pytest.raises(base.UserError, match=message):
        high.make_env(high_config.Task(**options))


def test_limits_are_told_before_there_is_a_run(tmp_path):
    task = high_config.Task(pixels=200)
    with pytest.raises(base.UserError, match="pixels = 200"):
        high.train(high_config.HighConfig(run=tmp_path / "run", task=task))
    assert not (tmp_path / "run").exists()


def test_measured_walking_takes_the_place_of_the_nominal(tmp_path):
    statistics = subgoals.Statistics(
        **dict.fromkeys((field.name for field in dataclasses.fields(subgoals.Statistics)), 0.0)
        | {"along_mean": 2.5, "along_std": 0.4, "lateral_std": 0.3}
    )
    text = json.dumps({"open floor": vars(statistics)})
    (tmp_path / subgoals.FILE).write_text(text)
    robot = robots.load("ant")
    bank = postures.PostureBank(qpos=postures.for_robot(robot).qpos[:7])
    postures.save(bank, tmp_path / subgoals.POSTURES, robot)
    env = high.make_env(high_config.Task(measured=tmp_path))
    assert env.movement.step == 2.5
    assert env.movement.sigma == pytest.approx(math.sqrt((0.16 + 0.09) / 2))
    with pytest.raises(base.UserError, match=r"subgoals\.json can't be read"):
        high.make_env(high_config.Task(measured=tmp_path / "nowhere"))
    with pytest.raises(base.UserError, match=r"sigma = 0\.5 can't be set together with measured"):
        high_config.Task(measured=tmp_path, sigma=0.5)


def test_a_folder_that_is_taken_is_noticed_first(tmp_path):
    (tmp_path / "something").touch()
    config = high_config.HighConfig(run=tmp_path, task=high_config.Task(maze="no such maze"))
    with pytest.raises(base.UserError, match="exists already"):
        high.train(config)


@pytest.mark.slow
def test_best_finds_the_goal_of_u_in_half_a_minute(tmp_path):
    """What has not been seen attracts from the start: chance alone seldom gets to the goal."""
    preset = presets.high_best()
    learner = dataclasses.replace(preset.learner, num_updates=100)
    task = dataclasses.replace(preset.task, maze="u")
    run = tmp_path / "run"
    high.train(dataclasses.replace(preset, task=task, learner=learner, run=run))
    last = (run / "metrics.csv").read_text().splitlines()[-1].split(",")
    assert float(last[3]) > 0.9


def test_evaluations_see_the_whole_maze_as_a_finished_policy_does(tmp_path):
    # From a dead end, the map that training has doesn't reach the way that wasn't taken.
    corridor = tmp_path / "corridor.txt"
    corridor.write_text("decisions 60\n#############\n#G....S....G#\n#############\n")
    task = high_config.Task(maze=str(corridor), robot="point", map_radius=2, sigma=0.0)
    network = high_config.Network(kind="search", num_iterations=4, look_ahead=2, tile_features=2)
    config = tiny(tmp_path / "run", greedy=True, num_eval_episodes=8, evaluate_every=2)
    learner = dataclasses.replace(config.learner, num_updates=2)
    high.train(dataclasses.replace(config, task=task, network=network, learner=learner))
    row = (tmp_path / "run" / "metrics.csv").read_text().splitlines()
    assert float(dict(zip(*(line.split(",") for line in row), strict=True))["eval/success"]) == 1.0
