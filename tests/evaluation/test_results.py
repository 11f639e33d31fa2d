import dataclasses
import json
import pathlib

import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.evaluation import loading, results, tables
from eihrl_jax.mazes import suites

ANT = results.Agent(robot="ant", movement="full", high="runs/one", low="ant")


def episodes(achieved, fallen, unstable, seed=None):
    num = len(achieved)
    return results.Episodes(
        visited=np.arange(max(achieved, default=0)) < np.array(achieved)[:, None],
        end_xy=np.zeros((num, 2)),
        returns=np.array(achieved, float),
        decisions=np.arange(1, num + 1),
        has_fallen=np.array(fallen, bool),
        is_unstable=np.array(unstable, bool),
        seed=np.zeros(num, int) if seed is None else np.array(seed),
    )


def cell(maze="g1", agent=ANT, achieved=(1, 1, 1, 0, 0)):
    none = [False] * len(achieved)
    return results.summarise(
        maze, agent, episodes(achieved, none, none), num_goals=1, num_decisions=24
    )


def test_every_episode_has_one_outcome():
    found = episodes([1, 1, 0, 0, 0], [1, 0, 1, 0, 0], [0, 0, 1, 1, 0])
    assert found.outcomes(1) == ["solved", "solved", "fallen", "unstable", "late"]
    summary = results.summarise("g1", ANT, found, num_goals=1, num_decisions=24)
    assert summary.outcomes == results.Outcomes(solved=2, fallen=1, unstable=1, late=1)
    assert "| 1 / 1 / 1 |" in tables.markdown([summary])
    assert summary.num_falls == 2
    assert summary.decisions_mean == 3.0
    assert summary.decisions_solved == 1.5


def test_seeds_are_summarised_apart():
    none = [False] * 4
    found = episodes([2, 1, 0, 0], none, none, seed=[7, 7, 3, 3])
    summary = results.summarise("s", ANT, found, num_goals=2, num_decisions=40)
    assert summary.seeds == (7, 3)
    assert summary.seed_rates == (0.75, 0.0)
    assert summary.success.rate == 0.375
    assert summary.goal_rates == (0.5, 0.25)
    assert "|   goal by goal, % | 50 / 25 |" in tables.markdown([summary])


def test_eval_json_round_trip(tmp_path):
    path = tmp_path / "eval.json"
    unsolved = cell(achieved=(0, 0))
    assert unsolved.decisions_solved is None
    evaluation = results.Evaluation(about={"by": "test"}, cells=(cell(), unsolved))
    results.save(path, evaluation)
    assert results.load(path) == evaluation
    content = json.loads(path.read_text())
    assert content["format"] == 2
    assert content["cells"][0]["success"]["rate"] == 0.6


def test_files_of_the_first_format_are_read_in_todays_words():
    root = pathlib.Path(__file__).parents[2]
    paths = sorted(root.glob("*/*/rand_h-random-?/eval.json"))
    assert len(paths) == 6
    for path in paths:
        assert json.loads(path.read_text())["format"] == 1
        evaluation = results.load(path)
        assert evaluation.about["config"]["high"] == ["uniform"]
        assert evaluation.about["versions"]["system"] == "Linux x86_64"
        (cell,) = evaluation.cells
        agent = dataclasses.replace(ANT, high="uniform")
        assert (cell.agent, cell.num_episodes) == (agent, 500)
        assert 0.05 < cell.success.rate < 0.1


def test_uniform_directions_are_still_understood_by_their_older_name():
    for name in ("uniform", "random"):
        assert loading.load_high(name).label == "uniform"


@pytest.mark.parametrize("text", ["no json", "[]", '{"cells": 3}', '{"format": 3, "cells": []}'])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "eval.json"
    path.write_text(text)
    with pytest.raises(base.UserError, match=r"eval\.json"):
        results.load(path)


def test_other_numbers_than_those_that_were_written_are_refused(tmp_path):
    path = tmp_path / "eval.json"
    results.save(path, results.Evaluation(cells=(cell(),)))
    path.write_text(path.read_text().replace("0.6", "0.7"))
    with pytest.raises(base.UserError, match=r"eval\.json is damaged"):
        results.load(path)


def test_table1_stands_beside_the_papers_figures():
    oracle = dataclasses.replace(ANT, movement="oracle", low=None)
    text = tables.markdown([cell("g1"), cell("g3", oracle), cell("mine")])
    assert "| 60.0 |" in text
    assert "[23.1, 88.2]" in text
    assert "45.6 ± 5.2" in text
    assert "84.8 ± 6.6" in text
    assert "27.8" not in text  # g2 was not evaluated
    assert text.count("mine") == 1
    assert all(len(line) < 100 for line in text.splitlines()[2:])


def test_uniform_high_level_has_no_figure_in_the_paper():
    text = tables.markdown([cell("g1", dataclasses.replace(ANT, high="uniform"))])
    assert "45.6" not in text


def test_a_baseline_walks_without_a_low_level_and_has_no_figure_of_ours():
    text = tables.markdown([cell("g1", dataclasses.replace(ANT, high="runs/higl", low=None))])
    assert text.count("ant, walking, runs/higl") == 1
    assert "oracle" not in text
    assert "| ant, walking | 60.0 |" in text
    assert "45.6" not in text


def test_runs_trained_alike_are_summarised_together():
    cells = [
        cell("g2", dataclasses.replace(ANT, high=f"runs/{i}"), achieved)
        for i, achieved in enumerate([(1, 1), (1, 0), (0, 0)])
    ]
    others = ("uniform", "runs/higl", "other/0")
    cells += [cell("g2", dataclasses.replace(ANT, high=high), (0, 0)) for high in others]
    ((key, spread),) = tables.over_runs(cells).items()
    assert key == ("runs/*", "g2", "ant", "full")
    assert (spread.mean, spread.std) == (0.5, 0.5)
    assert "50.0 ± 50.0" in tables.markdown(cells)


def test_tables_are_printed_whole_where_the_terminal_is_narrow(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    names = [f"runs/of-a-name-that-is-longer-than-forty-columns/seed-{i}" for i in range(2)]
    cells = [cell("g1", dataclasses.replace(ANT, high=name)) for name in names]
    tables.show(tables.terminal(cells))
    printed = capsys.readouterr().out
    assert names[0][:-1] + "*" in printed
    assert "95 % of the mean" in printed and "…" not in printed


def test_terminal_shows_the_same_tables():
    shown = tables.terminal([cell("g1")])
    assert [table.title for table in shown] == [
        "ant, walking with low level ant, high level runs/one",
        "Table 1, high level runs/one",
    ]
    assert shown[0].row_count == 1


def test_a_suite_has_a_row_above_its_mazes_where_all_of_them_were_evaluated():
    names = list(suites.mazes("jaxgcrl"))
    one = [cell(name) for name in names]
    lines = tables.markdown([*one, cell("mine")]).splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("| jaxgcrl, mean of 7 |"))
    assert [line.split("|")[1].strip() for line in lines[first + 1 :][:8]] == [*names, "mine"]
    mean, maze = (lines[i].split("|")[2] for i in (first, first + 1))
    assert float(mean) == float(maze.split("±")[0])
    assert "mean of" not in tables.markdown(one[1:])

    other = dataclasses.replace(ANT, high="best-u-1")
    both = [dataclasses.replace(c, agent=dataclasses.replace(ANT, high="best-u-0")) for c in one]
    both += [cell(name, other) for name in names]
    assert ("best-u-*", "jaxgcrl", "ant", ANT.movement) in tables.over_runs(both)
