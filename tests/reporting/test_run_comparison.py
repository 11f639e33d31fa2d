"""Runs side by side: who is drawn together, how lines are named, what tables tell."""

import json

import pytest

from eihrl_jax import base
from eihrl_jax.config import runs as runs_config
from eihrl_jax.drawing import curves
from eihrl_jax.reporting import run_comparison


@pytest.fixture
def make_run(tmp_path):
    def make(name, options, last=0.5):
        run = tmp_path / name
        run.mkdir()
        (run / "config.json").write_text(json.dumps({"run": name, **options}))
        rows = ["step,num_decisions,success,eval/success", "1,100,nan,", f"2,200,0.1,{last}"]
        (run / "metrics.csv").write_text("\n".join(rows) + "\n")
        (run / "versions.json").write_text('[{"seconds": 40.0}, {"seconds": 55.0}]')
        return run

    return make


def test_seeds_are_one_line_that_is_named_by_what_sets_it_apart(make_run, tmp_path, monkeypatch):
    runs = [
        make_run(f"{maze}-{seed}", {"seed": seed, "width": len(maze), "task": {"maze": maze}})
        for maze in ("u", "spiral")
        for seed in range(2)
    ]
    drawn = []
    monkeypatch.setattr(curves, "save_panels", lambda *args, **kwargs: drawn.append((args, kwargs)))
    out = tmp_path / "plot.png"
    run_comparison.plot(runs_config.PlotConfig(runs=tuple(runs), out=out))
    ((path, (panel,)), options) = drawn[0]
    assert (path, options) == (out, {"x_label": "decisions"})
    assert panel.y_label == "eval: success, %"
    # The width differs too, but follows from the maze.
    found = {label: [line.tolist() for line in lines] for label, lines in panel.groups.items()}
    assert found == {
        "task.maze u": [[[200.0, 50.0]]] * 2,
        "task.maze spiral": [[[200.0, 50.0]]] * 2,
    }


def test_metrics_that_no_run_has_are_refused(make_run, tmp_path):
    runs = (make_run("one", {}),)
    with pytest.raises(base.UserError, match="metrics = 'sucess'"):
        run_comparison.plot(runs_config.PlotConfig(runs=runs, metrics=("sucess",)))
    with pytest.raises(base.UserError, match="holds no run"):
        run_comparison.plot(runs_config.PlotConfig(runs=(tmp_path,)))


def test_comparison_tells_options_results_and_time(make_run):
    runs = (
        make_run("one", {"seed": 0, "preset": "paper", "same": 1}),
        make_run("other", {"seed": 1, "preset": "best", "same": 1, "more": 2}, last=0.75),
    )
    options, results = run_comparison.compare(runs_config.CompareRunsConfig(runs=runs))
    assert options.rows == [["preset", "paper", "best"], ["seed", "0", "1"], ["more", "-", "2"]]
    assert results.rows == [
        ["eval/success: success, %", "50.0", "75.0"],
        ["steps", "200 decisions", "200 decisions"],
        ["time, compilation included", "1 min 35 s", "1 min 35 s"],
        ["state", "not finished", "not finished"],
    ]
