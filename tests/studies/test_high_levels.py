"""Training what is shipped and reporting on it, with presets that are tiny."""

import dataclasses

import pytest

from eihrl_jax import base
from eihrl_jax.config import changes, presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.reporting import cached_runs, report
from eihrl_jax.runs import policies
from eihrl_jax.studies import ablate_high, train_policies


def tiny(name, **task):
    """Returns a preset of a few updates that plans on a small map."""
    return high_config.HighConfig(
        preset=name,
        task=high_config.Task(map_radius=2, robot="point", **task),
        network=high_config.Network(
            kind="planner", num_iterations=3, cell_features=2, value_features=2
        ),
        learner=high_config.Learner(num_workers=4, window=24, num_updates=5),
        log_every=1,
        evaluate_every=5,
        num_eval_episodes=4,
        checkpoint_every=5,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Returns the folder of high levels from tiny presets."""
    out = tmp_path_factory.mktemp("policies")
    with pytest.MonkeyPatch.context() as patch:
        rooms = tiny("generalist", num_rooms=3, room_sides=(4, 6))
        patch.setattr(presets, "HIGH", {"best": tiny("best"), "generalist": rooms})
        options = train_policies.PoliciesConfig(
            presets=("best", "generalist"), mazes=("random", "u"), seeds=(0, 1), out=out
        )
        train_policies.main(options)
        times = {path: path.stat().st_mtime_ns for path in out.glob("*/policy/meta.json")}
        train_policies.main(options)  # takes what is finished as it is
        assert times == {path: path.stat().st_mtime_ns for path in times}
    return out


def test_every_preset_is_trained_in_every_maze_and_the_generalist_in_rooms(trained):
    assert sorted(path.name for path in trained.iterdir()) == sorted(
        [f"best-{maze}-{seed}" for maze in ("random", "u") for seed in (0, 1)]
        + [f"generalist-rooms-{seed}" for seed in (0, 1)]
    )
    _, meta = policies.load(policies.find(trained / "generalist-rooms-1", "high"), kind="high")
    assert meta["maze"] == "3 random rooms"
    assert meta["network"]["kind"] == "planner" and meta["view"]["map_radius"] == 2


def test_runs_with_dense_reward_have_names_of_their_own(tmp_path):
    options = train_policies.PoliciesConfig(
        presets=("best",), mazes=("u",), rewards=("sparse", "dense"), seeds=(3,), out=tmp_path
    )
    runs = train_policies._options(options, 3)
    assert {run.run.name: run.task.reward for run in runs} == {
        "best-u-3": "sparse",
        "best-u-dense-3": "dense",
    }


def test_finished_runs_are_shipped_with_their_metrics(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(policies, "PRETRAINED", tmp_path)
    for _ in range(2):  # what is shipped is replaced
        train_policies.ship(trained / "best-u-0")
    assert policies.find("best-u-0", "high") == tmp_path / "best-u-0" / "high"
    assert (tmp_path / "best-u-0" / "high_metrics.csv").read_text().startswith("step,")


def test_report_shows_what_can_be_evaluated_and_reuses_it(trained, tmp_path, capsys):
    options = report.ReportConfig(
        policies=trained,
        parts=("table1", "more_time", "learning"),
        movement=("oracle",),
        episodes=3,
        num_rooms=4,
        out=tmp_path,
    )
    report.main(options)
    text = (tmp_path / "report.html").read_text()
    assert text.count("<table>") == 4 and text.count("<img") >= 3
    lines = (tmp_path / "tables.md").read_text()
    assert "| paper, oracle | 66.4 ± 5.4 | 72.0 ± 6.3 | 58.4 ± 8.3 | 84.8 ± 6.6 |" in lines
    assert "| ours, generalist, oracle |" in lines and "as in the paper" not in lines
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("eval.json")}
    assert len(times) == 7
    report.main(dataclasses.replace(options, parts=("table1",)))
    assert times == {path: path.stat().st_mtime_ns for path in times}
    assert "report.html" in capsys.readouterr().out
    with pytest.raises(base.UserError, match="was evaluated with other options"):
        report.main(dataclasses.replace(options, parts=("table1",), episodes=4))


def test_what_a_killed_evaluation_left_is_begun_anew(tmp_path):
    options = evaluate_config.EvaluateConfig(
        mazes=("u",),
        robot=("point",),
        movement=("oracle",),
        high=("uniform",),
        episodes=2,
        animate="none",
        out=tmp_path / "u",
    )
    left = tmp_path / "u.incomplete"
    left.mkdir()
    (left / "episodes.csv").write_text("half a line")
    (cell,) = cached_runs.evaluated(options)
    assert (cell.maze, cell.num_episodes) == ("u", 2)
    assert not left.exists()
    assert len((tmp_path / "u" / "episodes.csv").read_text().splitlines()) == 3


def test_bad_input_is_named(tmp_path):
    with pytest.raises(base.UserError, match=r"presets = 'better' must be one of best, "):
        train_policies.PoliciesConfig(presets=("better",))
    with pytest.raises(base.UserError, match="mazes is empty"):
        train_policies.PoliciesConfig(mazes=())
    with pytest.raises(base.UserError, match=r"parts = 'all' must be one of table1, "):
        report.ReportConfig(parts=("all",))
    options = report.ReportConfig(policies=tmp_path, parts=("learning",), out=tmp_path / "out")
    with pytest.raises(base.UserError, match="holds no <preset>-<maze>-<seed>"):
        report.main(options)


def test_variants_of_a_preset_are_trained_and_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(presets, "HIGH", {"best": tiny("best")})
    options = ablate_high.AblationConfig(
        preset="best",
        variants=("preset", "corners too", "entropy 0.02"),
        seeds=(0, 1),
        robot="point",
        movement=("oracle",),
        episodes=2,
        out=tmp_path,
    )
    ablate_high.main(options)
    lines = (tmp_path / "table.md").read_text().splitlines()
    labels = [line.split(" | ")[0].strip("| ") for line in lines[4:]]
    assert labels == [
        "preset, oracle",
        "corners too, oracle",
        "entropy 0.02, oracle",
        "RAND-H, oracle",
    ]
    assert lines[4].count("±") == 4 and lines[7].count("±") == 0
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    trained = (tmp_path / "entropy-0.02" / "seed-1" / "config.json").read_text()
    assert '"entropy": 0.02,' in trained
    shown = dataclasses.replace(
        report.ReportConfig(), parts=("ablations",), ablations=(tmp_path,), out=tmp_path / "report"
    )
    report.main(shown)
    lines = (tmp_path / "report" / "tables.md").read_text().splitlines()
    rows = [line.split(" | ")[0].strip("| ") for line in lines if "oracle |" in line]
    assert sorted(rows) == sorted(labels) and (rows[0], rows[-1]) == (labels[0], labels[-1])
    assert (tmp_path / "report" / "report.html").read_text().count("<img") == 1
    with pytest.raises(base.UserError, match="holds no evaluations"):
        report.main(dataclasses.replace(shown, ablations=(tmp_path / "report",)))


def test_every_variant_changes_something():
    for preset in (presets.high_paper(), presets.high_best()):
        for name, options in ablate_high.variants(preset.preset).items():
            assert (changes.apply(preset, options) == preset) == (name == "preset")
    with pytest.raises(base.UserError, match=r"variants = 'none' must be one of preset, "):
        ablate_high.AblationConfig(variants=("none",))
    with pytest.raises(base.UserError, match="log_every = 100 must divide num_updates = 250"):
        ablate_high.AblationConfig(num_updates=250)
