import re

import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.mazes import parsing

RING = "######"


def check(*inside: str, match: str) -> None:
    text = "\n".join((RING, *inside, RING))
    with pytest.raises(base.UserError, match=re.escape(match)) as caught:
        parsing.parse(text, name="mine.txt")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("mine.txt: ")


def test_every_character_means_what_the_legend_says():
    maze = parsing.parse("##D###\n#S.2##\n#S##3#\n#....#\n######")
    assert np.asarray(maze.wall).sum() == 6 + 3 + 4 + 2 + 6
    assert np.argwhere(np.asarray(maze.door)).tolist() == [[0, 2]]
    assert np.argwhere(np.asarray(maze.start)).tolist() == [[1, 1], [2, 1]]
    assert np.argwhere(np.asarray(maze.goal) == 2).tolist() == [[1, 3]]
    assert np.argwhere(np.asarray(maze.goal) == 3).tolist() == [[2, 4]]
    assert maze.num_goals == 3


def test_the_time_limit_grows_with_the_longest_shortest_tour():
    corridor = "#" * 32 + "\n#S" + "." * 28 + "1#\n" + "#" * 32
    assert parsing.parse(corridor).num_decisions == 4 * 29
    two_starts = corridor.replace(".1", "S1")
    assert parsing.parse(two_starts).num_decisions >= 4 * 29


def test_ragged_rows():
    check("#S..1#", "#...#", match="row 3 has 5 columns, but row 1 has 6")


def test_unknown_characters():
    check("#S..1#", "#.x..#", match="unknown character 'x' at row 3, column 3; known are")
    check("#S..1#", "#.0..#", match="unknown character '0' at row 3, column 3")
    check("#S.\t1#", match=r"unknown character '\t' at row 2, column 4")


def test_what_is_missing():
    check("#...1#", match="no start")
    check("#S...#", match="no goal")
    with pytest.raises(base.UserError, match="maze: the text is empty"):
        parsing.parse("\n  \n")


def test_goal_numbers():
    check("#S1.3#", match="goal 3 at row 2, column 5, but there is no 2")
    check("#S..2#", match="goal 2 at row 2, column 5, but there is no 1")
    check("#S1..D", match="goal 1 at row 2, column 3 beside door candidates")
    check("#S3..D", match="goal 3 at row 2, column 3, but there is no 2")


def test_free_candidates():
    check("#S1.G#", match="goal 1 at row 2, column 3 beside door candidates")
    check(
        "#S.G.D", match="row 2, column 6 beside the free one at row 2, column 4; candidates are all"
    )
    check(
        "#S#.G#",
        match="no way from the start at row 2, column 2 to the candidate at row 2, column 5",
    )
    check("#*..G#", match="the only start, at row 2, column 2, may be the goal; mark another one")
    check("#S...G", match="'G' at row 2, column 6 leaves the outer ring open")
    maze = parsing.parse("######\n#S*.G#\n######")
    assert np.argwhere(np.asarray(maze.door)).tolist() == [[1, 2], [1, 4]]
    assert np.argwhere(np.asarray(maze.start)).tolist() == [[1, 1], [1, 2]]
    assert not np.asarray(maze.wall)[1, 1:5].any() and maze.num_goals == 1


def test_open_ring():
    check("#S1...", match="'.' at row 2, column 6 leaves the outer ring open")
    check("SS.1.#", match="'S' at row 2, column 1 leaves the outer ring open")


def test_no_way():
    check("#S#.1#", match="no way from the start at row 2, column 2 to goal 1 at row 2, column 5")
    check("#S#S1#", match="no way from the start at row 2, column 2 to the start at row 2")
    check("#S#..D", match="to the door candidate at row 2, column 6")
    check("#SD..2", match="no way from the start at row 2, column 2 to goal 2 at row 2, column 6")
    check("#.S1##", "##D###", "######", match="goal 1 at row 2, column 4 beside door candidates")


def test_sizes():
    with pytest.raises(base.UserError, match="rows = 1 must be at least 3"):
        parsing.parse("#S1#")
    with pytest.raises(base.UserError, match="columns = 2051 must be at least 3 and at most 2050"):
        parsing.parse("\n".join(["#" * 2051] * 3))


def test_numbers_out_of_range():
    text = "####\n#S1#\n####"
    with pytest.raises(base.UserError, match="num_decisions = 0"):
        parsing.parse(text, num_decisions=0)
    with pytest.raises(base.UserError, match=r"start_jitter = 1\.5"):
        parsing.parse(text, start_jitter=1.5)
