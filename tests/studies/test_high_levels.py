"""Training what is shipped and reporting on it, with presets that are tiny."""

import dataclasses
import itertools
import json
import pathlib
import shutil

import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.config import changes, codec, presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import report as report_config
from eihrl_jax.evaluation import results
from eihrl_jax.reporting import cached_runs, evaluations, report
from eihrl_jax.runs import policies
from eihrl_jax.studies import ablate_high, train_policies
from eihrl_jax.training import high


def tiny(name, **task):
    """Returns a preset of a few updates that searches a small map."""
    return high_config.HighConfig(
        preset=name,
        task=high_config.Task(map_radius=2, robot="point", **task),
        network=high_config.Network(
            kind="search", num_iterations=3, look_ahead=2, cell_features=2, value_features=2
        ),
        learner=high_config.Learner(num_workers=4, window=24, num_updates=5),
        log_every=1,
        evaluate_every=5,
        num_eval_episodes=4,
        checkpoint_every=5,
    )


def made_up_training(options):
    """Leaves what a training leaves, as far as it is looked at."""
    meta = {"num_updates": options.learner.num_updates}
    policies.save(options.run / "policy", kind="high", params={}, meta=meta)
    (options.run / "config.json").write_text(codec.to_json(options))
    (options.run / "metrics.csv").write_text("step,eval/success\n1,0.1\n5,0.6\n")


def made_up_evaluation(options):
    """Leaves what an evaluation leaves, with rates that differ by high level and maze."""
    options.out.mkdir(parents=True, exist_ok=True)
    cells = []
    for robot, movement, high_level in itertools.product(
        options.robot, options.movement, options.high
    ):
        agent = results.Agent(robot=robot, movement=movement, high=high_level, low=None)
        for maze in options.mazes:
            num = options.episodes
            episodes = results.Episodes(
                visited=np.random.default_rng(len(cells)).integers(0, 2, (num, 1)) > 0,
                end_xy=np.zeros((num, 2)),
                returns=np.zeros(num),
                decisions=np.ones(num, int),
                has_fallen=np.zeros(num, bool),
                is_unstable=np.zeros(num, bool),
                seed=np.zeros(num, int),
            )
            cells.append(results.summarise(maze, agent, episodes, num_goals=1, num_decisions=24))
        maze = pathlib.PurePath(options.mazes[0]).stem
        pictures = [f"{maze}-heatmap.png", "heatmaps.png"] if options.heatmaps else []
        pictures += [f"{maze}.gif"] if options.animate != "none" else []
        for picture in pictures:
            (options.out / f"{agent.file_name}-{picture}").touch()
    num_episodes = sum(cell.num_episodes for cell in cells)
    (options.out / "episodes.csv").write_text("header\n" + "episode\n" * num_episodes)
    about = {"config": json.loads(codec.to_json(options))}
    results.save(options.out / "eval.json", results.Evaluation(about=about, cells=tuple(cells)))


@pytest.fixture(params=["made up", pytest.param("real", marks=pytest.mark.slow)])
def work(request, monkeypatch):
    """Trainings and evaluations are made up; for real they take minutes, all of it compilation."""
    if request.param == "made up":
        monkeypatch.setattr(high, "train", made_up_training)
        monkeypatch.setattr(evaluations, "evaluate", made_up_evaluation)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Returns the folder of high levels from tiny presets; the first is trained, others copy it."""
    out = tmp_path_factory.mktemp("policies")
    first, train = out / "best-random-0", high.train

    def train_first(options):
        if options.run == first:
            train(options)
        else:
            shutil.copytree(first, options.run)
            (options.run / "config.json").write_text(codec.to_json(options))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(presets, "HIGH", {name: tiny(name) for name in ("best", "paper")})
        patch.setattr(high, "train", train_first)
        options = train_policies.PoliciesConfig(
            presets=("best", "paper"), mazes=("random", "u"), seeds=(0, 1), out=out
        )
        train_policies.main(options)
        times = {path: path.stat().st_mtime_ns for path in out.glob("*/policy/meta.json")}
        train_policies.main(options)  # takes what is finished as it is
        assert times == {path: path.stat().st_mtime_ns for path in times}
    return out


def test_every_preset_is_trained_in_every_maze(trained):
    names = itertools.product(("best", "paper"), ("random", "u"), (0, 1))
    assert sorted(path.name for path in trained.iterdir()) == [
        f"{preset}-{maze}-{seed}" for preset, maze, seed in names
    ]
    _, meta = policies.load(policies.find(trained / "best-random-1", "high"), kind="high")
    assert meta["maze"] == "random"
    assert meta["network"]["kind"] == "search" and meta["view"]["map_radius"] == 2


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


def test_report_shows_what_can_be_evaluated_and_reuses_it(trained, work, tmp_path, capsys):
    options = report_config.ReportConfig(
        policies=trained,
        parts=("table1", "more_time", "learning"),
        movement=("oracle",),
        episodes=3,
        num_rooms=4,
        out=tmp_path,
    )
    report.main(options)
    text = (tmp_path / "report.html").read_text()
    assert "How this page was made" in text and "eihrl report --policies" in text
    assert f"<td>{options.episodes}, where" in text
    assert text.count("<table>") == 4 and text.count("<img") >= 3
    lines = (tmp_path / "tables.md").read_text()
    assert "| paper, oracle | 66.4 ± 5.4 | 72.0 ± 6.3 | 58.4 ± 8.3 | 84.8 ± 6.6 |" in lines
    assert "| ours, as in the paper, oracle |" in lines
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("eval.json")}
    assert len(times) == 7
    report.main(dataclasses.replace(options, parts=("table1",)))
    assert times == {path: path.stat().st_mtime_ns for path in times}
    assert "report.html" in capsys.readouterr().out
    with pytest.raises(base.UserError, match="was evaluated with other options"):
        report.main(dataclasses.replace(options, parts=("table1",), episodes=4))


def test_every_part_of_the_report_has_its_rows(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluations, "evaluate", made_up_evaluation)
    (trained / "higl-u-0").mkdir(exist_ok=True)
    options = report_config.ReportConfig(
        policies=trained,
        parts=("table1", "trained", "table2"),
        episodes=6,
        slow_episodes=2,
        out=tmp_path,
    )
    report.main(options)
    tables = (tmp_path / "tables.md").read_text().split("**")
    labels = {
        title: [line.split(" | ")[0].strip("| ") for line in text.split("\n")[4:] if line]
        for title, text in zip(tables[1::2], tables[2::2], strict=True)
    }
    walked = ["oracle", "walking"]
    best, ours, uniform, squares = (
        [f"{label}, {movement}" for movement in walked]
        for label in (
            "ours, best",
            "ours, as in the paper",
            "RAND-H",
            "ours, best, trained in the square",
        )
    )
    published = ["paper, oracle", "paper, walking", "paper, HIGL"]
    assert labels["Table 1"] == [*published, *best, *ours, *uniform]
    assert labels["U, S and Spiral"] == [*best, *ours, *squares]
    assert labels["Table 2, Maze-U"] == [
        *("paper, oracle", "paper, HIGL"),
        *(*best, *ours, "HIGL, walking"),
    ]
    # A row for each maze: the others were trained in U alone.
    thrice = [label for label in squares for _ in range(3)]
    assert labels["How their episodes ended"] == [*best, *ours, *thrice]
    humanoid = results.load(tmp_path / "evaluations" / "table2-best-humanoid-full" / "eval.json")
    assert {cell.num_episodes for cell in humanoid.cells} == {2}
    page = (tmp_path / "report.html").read_text()
    assert page.count("The walking ant, u.") == 4 and page.count("The humanoid in U.") == 2


def test_what_a_killed_evaluation_left_is_begun_anew(work, tmp_path):
    options = evaluate_config.EvaluateConfig(
        mazes=("u",),
        robot=("point",),
        movement=("oracle",),
        high=("uniform",),
        episodes=2,
        animate="none",
        heatmaps=False,
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
        report_config.ReportConfig(parts=("all",))
    options = report_config.ReportConfig(
        policies=tmp_path, parts=("learning",), out=tmp_path / "out"
    )
    with pytest.raises(base.UserError, match="holds no <preset>-<maze>-<seed>"):
        report.main(options)
    with pytest.raises(base.UserError, match="parts = own needs --high"):
        report.main(dataclasses.replace(options, parts=("own",)))


def test_variants_of_a_preset_are_trained_and_compared(work, tmp_path, monkeypatch):
    monkeypatch.setattr(presets, "HIGH", {"best": tiny("best")})
    options = ablate_high.AblationConfig(
        preset="best",
        variants=("preset", "corners too", "entropy 0.02"),
        seeds=(0, 1),
        robot="point",
        mazes=("u", "jaxued-labyrinth", "jaxued-labyrinth-2"),
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
        "frontier, oracle",
    ]
    assert lines[2] == "| success %, decisions / reference | u | jaxued-labyrinth |"
    assert lines[4].count("±") == 2 and lines[7].count("±") == 0
    assert lines[7].count(", 1.000 |") == 2
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    trained = (tmp_path / "entropy-0.02" / "seed-1" / "config.json").read_text()
    assert '"entropy": 0.02,' in trained
    shown = dataclasses.replace(
        report_config.ReportConfig(),
        parts=("ablations",),
        ablations=(tmp_path,),
        out=tmp_path / "report",
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
