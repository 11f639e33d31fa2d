"""Comparisons of evaluations, and the page they stand on."""

import dataclasses
import html.parser

import numpy as np
import pytest
from PIL import Image

from eihrl_jax import base
from eihrl_jax.config import report as report_config
from eihrl_jax.evaluation import results, tables
from eihrl_jax.reporting import comparison, page, report

ANT = results.Agent(robot="ant", movement="oracle", high="0", low=None)


def cell(maze, achieved, **agent):
    num = len(achieved)
    episodes = results.Episodes(
        visited=np.array(achieved, bool)[:, None],
        end_xy=np.zeros((num, 2)),
        returns=np.zeros(num),
        decisions=np.ones(num, int),
        has_fallen=np.arange(num) == 0,
        is_unstable=np.zeros(num, bool),
        seed=np.zeros(num, int),
    )
    agent = dataclasses.replace(ANT, **agent)
    return results.summarise(maze, agent, episodes, num_goals=1, num_decisions=24)


CELLS = [
    cell("g1", (1, 1, 1, 1), high="0"),
    cell("g1", (0, 1, 0, 1), high="1"),
    cell("g2", (0, 0, 1, 1), high="0"),
    cell("g1", (0, 0), high="0", movement="full", robot="point"),
]


def test_a_row_holds_the_mean_over_high_levels_or_what_was_published():
    rows = [
        comparison.Row("ours", comparison.select(CELLS, "oracle")),
        comparison.Row("paper", published={"g1": (72.0, 6.3), "g2": "≤ 1"}),
    ]
    table = comparison.success_by_maze("t", rows, ("g1", "g2", "g3"))
    assert table.header == ["success %", "Maze-g1", "Maze-g2", "Maze-g3"]
    assert table.rows == [
        ["ours", "75.0 ± 35.4 [0.0, 100.0]", "50.0 [15.0, 85.0]", "-"],
        ["paper", "72.0 ± 6.3", "≤ 1", "-"],
    ]


def test_robots_are_compared_and_mazes_taken_together():
    table = comparison.success_by_robot("t", [comparison.Row("all", CELLS)], ("ant", "point"))
    assert table.rows == [["all", "62.5 ± 17.7 [0.0, 100.0]", "0.0 [0.0, 65.8]"]]
    table = comparison.overall("t", [comparison.Row("oracle", CELLS[:3])])
    assert table.rows == [["oracle", "62.5 ± 17.7 [0.0, 100.0]"]]
    assert comparison.mean([]) == "-"


def test_trainings_that_all_came_out_alike_are_no_more_certain_than_their_episodes():
    alike = [cell("g1", (1, 1, 1, 1), high=str(seed)) for seed in range(3)]
    table = comparison.success_by_maze("t", [comparison.Row("ours", alike)], ("g1",))
    assert table.rows == [["ours", "100.0 ± 0.0 [51.0, 100.0]"]]


def test_searches_are_compared_by_their_decisions_maze_by_maze():
    def searched(maze, decisions, high):
        made = cell(maze, (1, 1), high=high)
        return dataclasses.replace(made, decisions_mean=decisions)

    evaluated = {
        "ours": [searched("m-0", 10.0, "0"), searched("m-1", 20.0, "0"), searched("n", 9.0, "0")],
        "frontier": [searched("m-0", 20.0, "frontier"), searched("m-1", 20.0, "frontier")],
    }
    table = comparison.of_variants("t", evaluated)
    assert table.header == ["success %, decisions / reference", "m", "n"]
    # The mean of 10 / 20 and 20 / 20, not 30 / 40.
    assert table.rows == [
        ["ours, oracle", "100.0, 0.750", "100.0, -"],
        ["frontier, oracle", "100.0, 1.000", "-, -"],
    ]


def test_failures_add_up_to_all_episodes():
    table = comparison.failures("t", [comparison.Row("oracle", CELLS[:3])])
    assert table.header == ["% of episodes", "maze", "solved", "fallen", "unstable", "late"]
    # The first episode of each high level has fallen; those that were solved all the same count so.
    assert table.rows == [
        ["oracle", "Maze-g1", "75.0", "12.5", "0.0", "12.5"],
        ["oracle", "Maze-g2", "50.0", "25.0", "0.0", "25.0"],
    ]


class Reader(html.parser.HTMLParser):
    """Collects tags, attributes and text; complains about tags that are not closed in order."""

    def __init__(self):
        super().__init__()
        self.open, self.attributes, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def sections(tmp_path):
    path = tmp_path / "dot.png"
    Image.new("RGB", (3, 2), "red").save(path)
    table = tables.Table(
        "Rooms <9x9>", ["", "success %"], [["ours & theirs", "≤ 1"], ["paper", "2"]]
    )
    picture = page.Picture(path, 'a "dot"')
    return [page.Section("One", "Text < text.", [table], [picture]), page.Section("Two")]


def test_page_is_well_formed_and_needs_nothing_else(sections, tmp_path):
    path = tmp_path / "report.html"
    page.write(path, "Title & more", "Lead.", sections)
    text = path.read_text()
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    (image,) = [attributes for tag, attributes in reader.attributes if tag == "img"]
    assert image["src"].startswith("data:image/png;base64,") and image["alt"] == 'a "dot"'
    assert {"Title & more", "Rooms <9x9>", "ours & theirs", "Text < text."} <= set(reader.text)
    assert ("tr", {"class": "published"}) in reader.attributes
    assert "http" not in text and "<script" not in text


def test_tables_come_as_markdown_too(sections):
    assert page.markdown(sections) == (
        "**Rooms \\<9x9>**\n\n|  | success % |\n| --- | --- |\n| ours & theirs | ≤ 1 |\n"
        "| paper | 2 |\n"
    )


def test_a_page_is_known_as_ours(tmp_path):
    page.write(tmp_path / "report.html", "t", "lead", ())
    (tmp_path / "other.html").write_text("<!doctype html>\n<title>precious</title>\n")
    assert page.is_ours(tmp_path / "report.html") and not page.is_ours(tmp_path / "other.html")


def test_one_report_at_a_time_writes_to_a_folder(tmp_path, monkeypatch):
    config = report_config.ReportConfig(parts=("own",), high=("uniform",), out=tmp_path / "out")
    made = []

    def write(config):
        # Another one is started meanwhile.
        with pytest.raises(base.UserError, match="out is being written to by another process"):
            report.main(config)
        made.append((config.out / "report.html").exists())
        page.write(config.out / "report.html", "t", "lead", ())

    monkeypatch.setattr(report, "_write", write)
    report.main(config)
    report.main(config)
    assert made == [False, True] and [path.name for path in config.out.iterdir()] == ["report.html"]
