"""The comparison at equal budgets: which runs it makes, with which options."""

import csv
import dataclasses
import json

import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import codec, presets
from eihrl_jax.envs import hierarchy
from eihrl_jax.evaluation import results
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import policies
from eihrl_jax.studies import compare_baselines
from eihrl_jax.training import baselines, high


@pytest.mark.parametrize("method", ["droq", "higl", "hrac", "hiro", "hess"])
def test_runs_are_named_as_the_report_finds_them_and_share_the_budget(method, tmp_path):
    config = compare_baselines.CompareConfig(methods=(method,), num_steps=50_000, out=tmp_path)
    run = compare_baselines.Run(method, "u", "dense", 2)
    options = compare_baselines.baseline_options(config, run)
    assert isinstance(options, baselines_config.BaselineConfig)
    assert options.run == tmp_path / f"{method}-u-dense-2"
    assert (options.method, options.maze, options.reward) == (method, "u", "dense")
    assert (options.seed, options.num_steps, options.resume) == (2, 50_000, True)
    sparse = compare_baselines.baseline_options(
        config, compare_baselines.Run(method, "s", "sparse", 0)
    )
    assert sparse.run == tmp_path / f"{method}-s-0"


def test_droq_updates_its_actor_once_per_control_step(tmp_path):
    config = compare_baselines.CompareConfig(methods=("droq",), out=tmp_path)
    shortened = compare_baselines.baseline_options(
        config, compare_baselines.Run("droq", "u", "dense", 0)
    )
    for options in (shortened, presets.BASELINES["droq"]):
        assert isinstance(options, baselines_config.FlatConfig)
        assert options.updates_per_step == options.learner.actor_period


@pytest.mark.parametrize(("maze", "row"), [("random", 4_800), ("s", 4_000), ("spiral", 10_000)])
def test_hess_tells_its_metrics_some_twenty_times(maze, row, tmp_path):
    run = compare_baselines.Run("hess", maze, "sparse", 0)
    options = compare_baselines.baseline_options(compare_baselines.CompareConfig(out=tmp_path), run)
    arena = baselines.make_arena(options)
    assert arena.baseline.steps_per_round * options.log_rounds == row


def test_a_budget_of_too_few_episodes_is_named_before_anything_is_trained(tmp_path):
    config = compare_baselines.CompareConfig(
        methods=("droq", "hess"), mazes=("spiral",), num_steps=90_000, out=tmp_path / "baselines"
    )
    with pytest.raises(base.UserError, match="num_steps = 90000 must be at least 100000 for hess"):
        compare_baselines.main(config)
    assert not config.out.exists()


@pytest.mark.parametrize("method", ["droq", "higl", "hess"])
def test_large_budgets_have_the_methods_own_schedules(method, tmp_path):
    config = compare_baselines.CompareConfig(num_steps=1_000_000, out=tmp_path)
    options = compare_baselines.baseline_options(
        config, compare_baselines.Run(method, "u", "sparse", 0)
    )
    preset = presets.BASELINES[method]
    own = {"maze": "u", "run": options.run, "resume": True, "checkpoint_every": 1, "log_rounds": 1}
    assert dataclasses.replace(options, **own) == dataclasses.replace(preset, **own)
    short = dataclasses.replace(config, num_steps=300_000)
    options = compare_baselines.baseline_options(
        short, compare_baselines.Run(method, "u", "sparse", 0)
    )
    own["num_steps"] = 300_000
    assert dataclasses.replace(options, **own) != dataclasses.replace(preset, **own)


@pytest.mark.parametrize("num_steps", [1, 50_000, 100_000, 1_000_000])
def test_our_decisions_fill_the_budget_but_for_less_than_a_row(num_steps, tmp_path):
    config = compare_baselines.CompareConfig(num_steps=num_steps, out=tmp_path)
    options = compare_baselines.high_options(config, compare_baselines.Run("ours", "s", "dense", 1))
    learner = options.learner
    assert learner.window is not None
    per_update = learner.num_workers * learner.window * robots.load("ant").steps_per_subgoal
    row = per_update * options.log_every
    assert max(row, num_steps - row) <= learner.num_updates * per_update <= max(row, num_steps)
    assert options.run == tmp_path / "ours-s-dense-1"
    assert (options.task.maze, options.task.reward, options.seed) == ("s", "dense", 1)


def test_each_run_is_made_once_seed_by_seed(tmp_path, monkeypatch):
    config = compare_baselines.CompareConfig(
        methods=("ours", "rand_h", "droq"), mazes=("u",), rewards=("dense",), out=tmp_path
    )
    made = []

    def finish(options, kind, meta):
        policies.save(options.run / "policy", kind=kind, params={}, meta=meta)
        (options.run / "config.json").write_text(codec.to_json(options))
        made.append(options.run.name)

    def evaluate(options):
        about = {"config": json.loads(codec.to_json(options))}
        options.out.mkdir()
        results.save(options.out / "eval.json", results.Evaluation(about=about, cells=()))
        made.append(options.out.name.removesuffix(".incomplete"))

    monkeypatch.setattr(
        compare_baselines,
        "_train_ours",
        lambda options: finish(options, "high", {"num_updates": options.learner.num_updates}),
    )
    monkeypatch.setattr(
        baselines,
        "train",
        lambda options: finish(options, "baseline", {"num_steps": options.num_steps}),
    )
    monkeypatch.setattr(evaluations, "evaluate", evaluate)
    for _ in range(2):
        compare_baselines.main(config)
        methods = ("ours", "rand_h", "droq")
        assert made == [f"{method}-u-dense-{seed}" for seed in (0, 1, 2) for method in methods]


def test_ours_is_evaluated_with_physics_too(tmp_path, monkeypatch):
    config = compare_baselines.CompareConfig(out=tmp_path)
    options = compare_baselines.high_options(config, compare_baselines.Run("ours", "s", "dense", 0))
    calls = []
    monkeypatch.setattr(high, "train", lambda *args, **kwargs: calls.append((args, kwargs)))
    compare_baselines._train_ours(options)
    (((trained,), others),) = calls
    (walking,) = others.values()
    assert trained == options
    assert isinstance(walking, hierarchy.Hierarchy)
    assert walking.env._reward == "dense" and walking.env.robot.name == "ant"
    assert int(walking.table.mazes.num_decisions.max()) == 40


@pytest.mark.slow  # A minute, nearly all of it compilation: learning, evaluations, walking.
def test_ours_learns_and_walks_and_rand_h_only_walks(tmp_path):
    config = compare_baselines.CompareConfig(
        methods=("ours", "rand_h"),
        mazes=("u",),
        rewards=("dense",),
        seeds=(0,),
        num_steps=4_000,
        out=tmp_path,
    )
    compare_baselines.main(config)
    with (tmp_path / "ours-u-dense-0" / "metrics.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    assert float(last["num_decisions"]) == 4_000 / 25
    # What hasn't been seen attracts the planner from the start; uniform directions lead nowhere.
    assert min(float(last["eval/success"]), float(last["walking/success"])) >= 0.6
    assert 0.0 < float(last["walking/reward"]) < 1.0
    (cell,) = results.load(tmp_path / "rand_h-u-dense-0" / "eval.json").cells
    assert cell.success.rate <= 0.1
    assert cell.decisions_mean == 24.0
    # The ant is nearer to the goal than 1 / 0.05 units, and never so near as to be paid 1.
    assert 0.05 < cell.return_mean / cell.decisions_mean < float(last["walking/reward"])

    found = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*") if file.is_file()}
    compare_baselines.main(config)
    assert found == {
        file: file.stat().st_mtime_ns for file in tmp_path.rglob("*") if file.is_file()
    }


@pytest.mark.parametrize(
    ("name", "value"),
    [("methods", ("sarsa",)), ("mazes", ("moon",)), ("seeds", ()), ("num_steps", 0)],
)
def test_bad_options_are_named(name, value):
    with pytest.raises(base.UserError, match=name):
        compare_baselines.CompareConfig(**{name: value})
