import json

import pytest

from eihrl_jax import base
from eihrl_jax.config import value_gap as gap_config
from eihrl_jax.reporting import value_gaps


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    out = tmp_path_factory.mktemp("gap") / "out"
    options = gap_config.ValueGapConfig(
        high="best-random-0",
        mazes=("g1",),
        sigmas=(0.3, 0.31),
        robots=("point",),
        episodes=64,
        full_episodes=16,
        out=out,
    )
    return options, value_gaps.compare(options)


def test_reference_against_itself_is_no_gap(compared):
    """Same noise, same random numbers: nothing is lost, and the bound says so."""
    same = compared[1][0]
    assert (same.success_gap, same.value_gap, same.value_margin) == (0.0, 0.0, 0.0)
    assert same.success_bound == pytest.approx(0.0, abs=1e-9)


def test_gaps_are_within_bounds(compared):
    """Three movements; the measured gap minus its margin is no greater than the bound."""
    gaps = compared[1]
    assert [(gap.movement, gap.sigma) for gap in gaps] == [
        ("oracle", 0.3),
        ("oracle", 0.31),
        ("point", None),
    ]
    for gap in gaps:
        assert abs(gap.success_gap) - gap.success_margin <= gap.success_bound
        assert abs(gap.value_gap) - gap.value_margin <= gap.value_bound
    assert 0.1 < gaps[1].success_bound < 0.9  # which says something


def test_files_hold_what_was_returned(compared):
    options, gaps = compared
    document = json.loads((options.out / "gap.json").read_text())
    assert document["gaps"] == [vars(gap) for gap in gaps]
    assert (options.out / "gap.png").read_bytes()[:4] == b"\x89PNG"
    table = (options.out / "gap.md").read_text()
    assert "point, walking" in table and "oracle, sigma 0.31" in table


def test_maze_with_several_goals_is_refused(tmp_path):
    options = gap_config.ValueGapConfig(mazes=("s",), out=tmp_path / "out")
    with pytest.raises(base.UserError, match="'s' has 3 goals, must have 1"):
        value_gaps.compare(options)


def test_folder_is_not_overwritten(tmp_path):
    (tmp_path / "kept").write_text("x")
    with pytest.raises(base.UserError, match="not empty"):
        value_gaps.compare(gap_config.ValueGapConfig(out=tmp_path))
