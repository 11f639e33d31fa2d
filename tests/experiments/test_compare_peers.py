"""The comparison at equal budgets: which runs it makes, with which options."""

import csv

import pytest

from eihrl_jax import base, presets, robots
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.evaluation import results
from experiments import compare_peers


@pytest.mark.parametrize("method", ["droq", "higl", "hrac", "hiro", "hess"])
def test_runs_are_named_as_the_report_finds_them_and_share_the_budget(method, tmp_path):
    config = compare_peers.CompareConfig(methods=(method,), num_steps=50_000, out=tmp_path)
    run = compare_peers.Run(method, "u", "dense", 2)
    options = compare_peers.baseline_options(config, run)
    assert isinstance(options, baselines_config.BaselineConfig)
    assert options.run == tmp_path / f"{method}-u-dense-2"
    assert (options.method, options.maze, options.reward) == (method, "u", "dense")
    assert (options.seed, options.num_steps, options.resume) == (2, 50_000, True)
    sparse = compare_peers.baseline_options(config, compare_peers.Run(method, "s", "sparse", 0))
    assert sparse.run == tmp_path / f"{method}-s-0"


def test_droq_updates_its_actor_once_per_control_step(tmp_path):
    config = compare_peers.CompareConfig(methods=("droq",), out=tmp_path)
    shortened = compare_peers.baseline_options(config, compare_peers.Run("droq", "u", "dense", 0))
    for options in (shortened, presets.BASELINES["droq"]):
        assert isinstance(options, baselines_config.FlatConfig)
        assert options.updates_per_step == options.learner.actor_period


@pytest.mark.parametrize("num_steps", [1, 50_000, 100_000, 1_000_000])
def test_our_decisions_fill_the_budget_but_for_less_than_a_row(num_steps, tmp_path):
    config = compare_peers.CompareConfig(num_steps=num_steps, out=tmp_path)
    options = compare_peers.high_options(config, compare_peers.Run("ours", "s", "dense", 1))
    learner = options.learner
    assert learner.window is not None
    per_update = learner.num_workers * learner.window * robots.load("ant").steps_per_subgoal
    row = per_update * options.log_every
    assert max(row, num_steps - row) <= learner.num_updates * per_update <= max(row, num_steps)
    assert options.run == tmp_path / "ours-s-dense-1"
    assert (options.task.maze, options.task.reward, options.seed) == ("s", "dense", 1)


def test_ours_learns_and_walks_and_rand_h_only_walks(tmp_path):
    config = compare_peers.CompareConfig(
        methods=("ours", "rand_h"),
        mazes=("u",),
        rewards=("dense",),
        seeds=(0,),
        num_steps=4_000,
        out=tmp_path,
    )
    compare_peers.main(config)
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
    compare_peers.main(config)
    assert found == {
        file: file.stat().st_mtime_ns for file in tmp_path.rglob("*") if file.is_file()
    }


@pytest.mark.parametrize(
    ("name", "value"),
    [("methods", ("sarsa",)), ("mazes", ("moon",)), ("seeds", ()), ("num_steps", 0)],
)
def test_bad_options_are_named(name, value):
    with pytest.raises(base.UserError, match=name):
        compare_peers.CompareConfig(**{name: value})
