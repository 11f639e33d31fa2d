"""Learning and its budgets: what is drawn, and against what."""

import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.drawing import curves
from eihrl_jax.evaluation import results, statistics
from eihrl_jax.reporting import baseline_curves

BASELINE = """step,success,episodes,eval/success,eval/reward,eval/return
2000,nan,0.0,,,
4000,0.5,2.0,0.1,0.01,0.1
6000,0.5,4.0,,,
8000,0.5,2.0,0.4,0.02,0.4
"""
OURS = """step,num_decisions,decisions,eval/success,eval/reward,eval/return
20,1000.0,20.0,0.2,0.1,0.2
40,2000.0,10.0,,,
60,3000.0,10.0,0.9,0.3,0.9
"""

EQUAL = """step,num_decisions,episodes,decisions,eval/success,eval/return,walking/success,\
walking/return
5,160.0,4.0,nan,0.5,0.5,0.4,0.4
10,320.0,8.0,20.0,0.9,0.9,0.8,0.8
"""
RANDOM = results.Cell(
    maze="u",
    agent=results.Agent(robot="ant", movement="full", high="uniform", low="ant"),
    seeds=(0,),
    num_episodes=10,
    num_goals=1,
    num_decisions=24,
    success=statistics.Success(rate=0.3, low=0.1, high=0.6, block_std=None),
    seed_rates=(0.3,),
    return_mean=6.0,
    decisions_mean=24.0,
    decisions_solved=None,
    num_falls=0,
    outcomes=results.Outcomes(solved=3, fallen=0, unstable=0, late=7),
)


@pytest.fixture
def undrawn(monkeypatch):
    """Leaves the pictures empty, where nobody looks at them."""
    monkeypatch.setattr(curves, "save_spread", lambda path, *_, **__: path.touch())


@pytest.fixture
def folders(tmp_path):
    for name, text in (
        ("baselines/higl-u", BASELINE),
        ("baselines/droq-u-dense", BASELINE),
        ("ours/best-u", OURS),
    ):
        for seed in (0, 1):
            run = tmp_path / f"{name}-{seed}"
            run.mkdir(parents=True)
            (run / "metrics.csv").write_text(text)
    run = tmp_path / "baselines" / "ours-u-0"
    run.mkdir()
    (run / "metrics.csv").write_text(EQUAL)
    run = tmp_path / "baselines" / "rand_h-u-0"
    run.mkdir()
    results.save(run / "eval.json", results.Evaluation(cells=(RANDOM,)))
    return tmp_path


def test_episodes_and_steps_are_counted_up_to_each_evaluation(folders):
    baseline = folders / "baselines" / "higl-u-0" / "metrics.csv"
    ours = folders / "ours" / "best-u-0" / "metrics.csv"
    equal = folders / "baselines" / "ours-u-0" / "metrics.csv"
    for file, axis, expected in (
        (equal, "episodes", [[4.0, 0.5], [12.0, 0.9]]),
        (equal, "control steps", [[4e3, 0.5], [8e3, 0.9]]),
        (baseline, "episodes", [[2.0, 0.1], [8.0, 0.4]]),
        (baseline, "control steps", [[4000.0, 0.1], [8000.0, 0.4]]),
        (ours, "episodes", [[50.0, 0.2], [250.0, 0.9]]),
        (ours, "control steps", [[25e3, 0.2], [75e3, 0.9]]),
    ):
        found = baseline_curves.AXES[axis](file, "eval/success")
        np.testing.assert_allclose(found, expected)


def ours(folders):
    """Finds our metrics as `sections.Runs.metrics` does."""
    return lambda trained: sorted((folders / "ours").glob(f"{trained}-[0-9]*/metrics.csv"))


def task(folders, maze):
    return baseline_curves.Task(folders / "baselines", maze, "sparse")


@pytest.mark.parametrize(("y", "value"), [("success", 0.3), ("return", 6.0), ("reward", 0.25)])
def test_rand_h_is_a_level_line_along_all_others(folders, y, value):
    others = {"ours, walking": [np.array([[4e3, 0.5], [8e3, 0.9]])]}
    (line,) = task(folders, "u")._uniform(y, others)["RAND-H"]
    np.testing.assert_allclose(line, [[4e3, value], [8e3, value]])
    assert not task(folders, "s")._uniform(y, others)


def test_ours_has_a_line_walking_and_one_moved_by_the_oracle(folders):
    found = task(folders, "u").curves("success", baseline_curves.by_steps)
    assert list(found) == ["ours, walking", "ours, oracle", "HIGL", "RAND-H"]
    assert found["ours, walking"][0][:, 1].tolist() == [0.4, 0.8]
    assert found["ours, oracle"][0][:, 1].tolist() == [0.5, 0.9]
    assert len(found["HIGL"]) == 2


def test_runs_of_other_settings_and_those_not_yet_begun_are_no_seeds(folders):
    folder = folders / "baselines"
    for name in ("higl-u-5-updates", "higl-u-anywhere-0"):
        (folder / name).mkdir()
        (folder / name / "metrics.csv").write_text(BASELINE)
    (folder / "higl-u-2").mkdir()
    found = task(folders, "u").curves("success", baseline_curves.by_steps)
    assert len(found["HIGL"]) == 2


def test_every_task_that_a_baseline_learned_has_its_pictures(folders):
    section = baseline_curves.section(ours(folders), folders / "baselines", folders / "out")
    assert [picture.path.name for picture in section.pictures] == [
        "baselines-u-return-episodes.png",
        "baselines-u-return-control-steps.png",
        "baselines-u-success-episodes.png",
        "baselines-u-success-control-steps.png",
        "baselines-u-dense-reward-episodes.png",
        "baselines-u-dense-reward-control-steps.png",
        "baselines-u-dense-success-episodes.png",
        "baselines-u-dense-success-control-steps.png",
    ]
    assert all(picture.path.stat().st_size > 10_000 for picture in section.pictures)
    success, goals, dense_success, dense_reward, reached = section.tables
    ends = "at the end: mean (range), seeds"
    assert success.title == f"Success, %, sparse reward, {ends}"
    assert goals.title == f"Goals reached per episode, sparse reward, {ends}"
    assert success.rows == [
        ["ours, walking", "80 (80 to 80), 1", "80", "8,000"],
        ["ours, oracle", "90 (90 to 90), 1", "90", "8,000"],
        ["HIGL", "40 (40 to 40), 2", "40 [40, 40]", "8,000"],
        ["RAND-H", "30 (30 to 30), 1", "30", "none"],
    ]
    assert goals.rows[2][1] == "0.40 (0.40 to 0.40), 2"
    assert dense_success.rows[0][:2] == ["flat DroQ", "40 (40 to 40), 2"]
    assert dense_reward.rows[0][:2] == ["flat DroQ", "0.020 (0.020 to 0.020), 2"]
    # RAND-H's return of 6 goals is made up.
    assert reached.rows == [
        [
            "u",
            "goals reached per episode",
            "0.80 (0.80 to 0.80), 1",
            "RAND-H 6.00 (6.00 to 6.00), 1",
        ]
    ]


def test_one_reward_is_enough(folders, undrawn):
    for seed in (0, 1):
        (folders / "baselines" / f"droq-u-dense-{seed}" / "metrics.csv").unlink()
    section = baseline_curves.section(ours(folders), folders / "baselines", folders / "out")
    assert [picture.path.name.split("-")[2] for picture in section.pictures] == [
        *("return", "return", "success", "success")
    ]
    assert [table.title.split(",")[0] for table in section.tables[:2]] == [
        "Success",
        "Goals reached per episode",
    ]


HALF = BASELINE.partition("6000")[0]


@pytest.mark.parametrize(
    "text",
    ["", BASELINE.partition("2000")[0], BASELINE.partition("4000")[0], HALF, HALF + "6000,0."],
)
def test_runs_that_have_not_spent_the_budget_are_left_out(folders, undrawn, text):
    for name in ("higl-u-2", "hess-u-0", "hess-g1-0"):
        run = folders / "baselines" / name
        run.mkdir()
        (run / "metrics.csv").write_text(text)
    section = baseline_curves.section(ours(folders), folders / "baselines", folders / "out")
    table = section.tables[0]
    assert ["HIGL", "40 (40 to 40), 2"] in [row[:2] for row in table.rows]
    assert ("HESS" in [row[0] for row in table.rows]) == ("4000" in text)  # alone in g1
    assert table.header[:-2] == ["method", "u", *(["g1"] if "4000" in text else [])]


def test_methods_have_budgets_of_their_own(folders, undrawn):
    for name, factor, successes in (("u", 10, (0.2, 0.6)), ("s", 5, (0.4, 0.8))):
        for seed, success in enumerate(successes):
            run = folders / "baselines" / f"hess-{name}-{seed}"
            run.mkdir()
            text = f"step,success,episodes,eval/success,eval/reward,eval/return\n{factor * 1000}"
            (run / "metrics.csv").write_text(f"{text},nan,2.0,{success},0.0,{success}\n")
    section = baseline_curves.section(ours(folders), folders / "baselines", folders / "out")
    rows = {row[0]: row[1:] for row in section.tables[0].rows}
    assert rows["HIGL"] == ["40 (40 to 40), 2", "-", "-", "8,000"]
    both = ["40 (20 to 60), 2", "60 (40 to 80), 2", "50 [30, 70]", "10,000 in u; 5,000 in s"]
    assert rows["HESS"] == both


def test_what_was_reached_before_an_episode_ended_has_no_place_on_their_axis(tmp_path):
    file = tmp_path / "metrics.csv"
    file.write_text("step,episodes,eval/success\n4000,0.0,0.1\n8000,3.0,0.2\n")
    assert baseline_curves.by_episodes(file, "eval/success").tolist() == [[3.0, 0.2]]


def test_a_table_that_is_none_is_named(folders, undrawn):
    file = folders / "baselines" / "higl-u-0" / "metrics.csv"
    file.write_bytes(bytes(range(128, 256)))
    with pytest.raises(base.UserError, match=r"higl-u-0.metrics\.csv is no text"):
        baseline_curves.section(ours(folders), folders / "baselines", folders / "out")


def test_a_folder_without_baselines_is_named(folders):
    with pytest.raises(base.UserError, match="holds no <method>-<maze>-<seed>"):
        baseline_curves.section(ours(folders), folders / "ours", folders / "out")
    assert not baseline_curves.section(ours(folders), None, folders / "out").pictures
