"""Statistics of subgoals from handmade walks, and a whole measurement of the shipped ant."""

import dataclasses
import json
import math

import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import measure as measure_config
from eihrl_jax.envs import end_points, postures, subgoals
from eihrl_jax.evaluation import ends, falls, measure, statistics, tables
from eihrl_jax.evaluation import steps as steps_lib
from eihrl_jax.reporting import measurements

ANT = dataclasses.replace(robots.load("ant"), steps_per_subgoal=2)


def _steps(num_steps, num_robots=1, **given):
    """Steps of robots that stand where they are, subgoals of two steps each."""
    shape = (num_steps, num_robots)
    no, zero = np.zeros(shape, bool), np.zeros(shape, np.float32)
    fields = {
        "direction": np.zeros(shape, np.int32),
        "start": steps_lib.SubgoalStart(is_upright=~no, is_clear=~no),
        "switched": zero + (np.arange(num_steps) % 2 == 1)[:, None],
        "along": zero,
        "lateral": zero,
        "was_down": no,
        "fell": zero,
        "broke_down": zero,
        "ended": no,
        "qpos": np.zeros((*shape, 15), np.float32),
    }
    return steps_lib.Steps(**fields | given)


def _column(*values, kind=np.float32):
    return np.array(values, kind)[:, None]


def test_moments_are_those_of_clear_subgoals_begun_upright():
    is_clear = _column(1, 1, 1, 1, 0, 0, 1, 1, kind=bool)
    is_upright = _column(1, 1, 1, 1, 1, 1, 0, 0, kind=bool)
    found = measure.summarise(
        _steps(
            8,
            along=_column(0, 2.0, 0, 4.0, 0, 9.0, 0, 9.0),
            lateral=_column(0, 0.5, 0, -0.1, 0, 9.0, 0, 9.0),
            start=steps_lib.SubgoalStart(is_upright=is_upright, is_clear=is_clear),
        ),
        ANT,
        sigma=0.3,
    )
    assert found.num_subgoals == 3 and found.blocked == pytest.approx(1 / 3)
    assert (found.along_mean, found.along_std) == pytest.approx((3.0, 1.0))
    assert (found.lateral_mean, found.lateral_std) == pytest.approx((0.2, 0.3))
    assert found.correlation == pytest.approx(-1.0)
    assert found.sigma == pytest.approx(math.sqrt((1.0 + 0.09) / 2))
    assert found.falls == 0.0 and math.isnan(found.recovered)


def test_falls_and_recoveries():
    """Down in steps 1 to 3 of the first robot; the second falls in step 2 and stays down."""
    num = 40
    fell, was_down = np.zeros((num, 2), np.float32), np.zeros((num, 2), bool)
    fell[1, 0] = fell[2, 1] = 1
    was_down[2:5, 0] = was_down[3:, 1] = True
    steps = _steps(num, 2, fell=fell, was_down=was_down)
    assert falls.recovery_times(steps, 25).tolist() == [4.0, math.inf]
    found = measure.summarise(steps, ANT, sigma=0.3)
    assert found.recovered == 0.5 and found.recovery_seconds == pytest.approx(0.4)
    assert found.num_subgoals == 40  # two robots, 40 steps, two steps a subgoal
    assert found.falls == pytest.approx(2000 / 40)


def test_a_fall_shortly_before_the_end_says_nothing_of_recovery():
    fell, ended, was_down = (np.zeros((40, 1)) for _ in range(3))
    fell[10], ended[12], was_down[11:13] = 1, 1, 1
    steps = _steps(40, fell=fell, ended=ended > 0, was_down=was_down > 0)
    assert len(falls.recovery_times(steps, 25)) == 0


def test_falls_by_turn():
    """East, east, west and a fall, north begun lying; a new episode: west, south and a fall, north.

    Each subgoal takes two steps. The second robot goes east all the time, and falls at the start.
    """
    direction = np.repeat(np.array([[0, 0, 1, 2, 1, 3, 2], [0] * 7], np.int32).T, 2, axis=0)
    ended, is_upright = np.zeros((14, 2), bool), np.ones((14, 2), bool)
    ended[7] = True
    is_upright[6:8, 0] = False
    fell = np.zeros((14, 2), np.float32)
    fell[[4, 6, 11], 0] = fell[0, 1] = 1
    steps = _steps(
        14,
        2,
        direction=direction,
        ended=ended,
        fell=fell,
        start=steps_lib.SubgoalStart(is_upright=is_upright, is_clear=is_upright),
    )
    # Straight: one of the first robot, five of the second; a quarter: west, south; half: two.
    assert falls.by_turn(steps) == {"straight": 0.0, "quarter": 1000.0, "half": 500.0}
    steps = steps.replace(fell=fell[:, ::-1])
    assert falls.by_turn(steps) == {"straight": 500.0, "quarter": 0.0, "half": 0.0}
    alone = falls.by_turn(_steps(4))
    assert alone["straight"] == 0.0 and math.isnan(alone["quarter"]) and math.isnan(alone["half"])


def test_end_points_are_in_the_worlds_frame():
    steps = _steps(
        8,
        direction=np.repeat(np.arange(4, dtype=np.int32), 2)[:, None],
        along=_column(*[3.0] * 8),
        lateral=_column(*[1.0] * 8),
    )
    found = ends.by_direction(steps)
    left_xy = ((0, 1), (0, -1), (-1, 0), (1, 0))
    for index, unit_xy in enumerate(base.DIRECTIONS_XY):
        expected = 3.0 * np.array(unit_xy) + np.array(left_xy[index])
        np.testing.assert_allclose(found[index], expected[None])


def test_a_law_tells_how_each_subgoal_began(tmp_path):
    """East, north, south and a fall in it, up again, north; then an episode that ends, and east."""
    direction = np.repeat(np.array([0, 2, 3, 3, 2, 0], np.int32), 2)[:, None]
    fell, was_down, ended, is_upright = (np.zeros((12, 1), bool) for _ in range(4))
    fell[5], was_down[6:8], ended[9] = True, True, True
    is_upright[:] = True
    is_upright[6:8] = False
    steps = _steps(
        12,
        direction=direction,
        along=_column(*np.arange(12)),
        lateral=_column(*np.arange(12) / 2),
        fell=fell.astype(np.float32),
        was_down=was_down,
        ended=ended,
        start=steps_lib.SubgoalStart(is_upright=is_upright, is_clear=np.ones((12, 1), bool)),
    )
    found = ends.law(steps)
    names = [end_points.CONDITIONS[condition] for condition in found.condition]
    assert names == ["rest", "left", "behind", "down", "rest", "rest"]
    assert found.along.tolist() == [1, 3, 5, 7, 9, 11] and found.lateral[1] == 1.5
    assert found.is_down.tolist() == [False, False, True, True, False, False]

    path = tmp_path / end_points.FILE
    end_points.save(path, "ant", found, found)
    again = end_points.load(path, "ant", anchored=True)
    for column, other in zip(vars(found).values(), vars(again).values(), strict=True):
        np.testing.assert_array_equal(column, other)
    with pytest.raises(base.UserError, match="are of robot 'ant', expected 'point'"):
        end_points.load(path, "point", anchored=True)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(base.UserError, match="can't be read"):
        end_points.load(path, "ant", anchored=False)


def test_drift_is_from_the_centre_of_ones_own_cell_in_the_subgoals_frame():
    """Two subgoals to the north; the second robot comes only one cell far, the third falls."""
    direction = np.full((5, 3), 2, np.int32)
    qpos = np.zeros((5, 3, 15), np.float32)
    qpos[0, :, :2] = 1.5
    qpos[4, :, :2] = [[1.6, 7.3], [1.5, 4.5], [1.5, 7.5]]
    was_down = np.zeros((5, 3), bool)
    was_down[3, 2] = True
    steps = _steps(5, 3, direction=direction, qpos=qpos, was_down=was_down)
    found = measure.drift_after(steps, 2, ANT, anchored=True)
    assert (found.num_robots, found.in_cell, found.anchored) == (2, 0.5, True)
    assert (found.along_mean, found.lateral_mean) == pytest.approx((-0.1, -0.05))
    assert (found.along_std, found.lateral_std) == pytest.approx((0.1, 0.05))


@pytest.mark.parametrize(("shift", "sigma", "expected"), [(0.0, 0.3, 0.0), (-0.7, 0.3, 0.7)])
def test_distance_to_the_normal_law(shift, sigma, expected):
    sample = np.random.default_rng(0).normal(shift, 0.3, 40_000)
    assert statistics.wasserstein(sample, sigma) == pytest.approx(expected, abs=0.01)


def test_distance_of_normal_laws_of_other_widths():
    """Between N(0, a) and N(0, b) it is |a - b| times the mean of |N(0, 1)|."""
    sample = np.random.default_rng(1).normal(0.0, 0.5, 40_000)
    expected = 0.2 * math.sqrt(2 / math.pi)
    assert statistics.wasserstein(sample, 0.3) == pytest.approx(expected, abs=0.01)


def test_measuring_the_shipped_ant(tmp_path):
    out = tmp_path / "out"
    options = measure_config.MeasureConfig(num_subgoals=100, num_envs=10, num_postures=50, out=out)
    measured = measurements.measure(options)
    found = measured.statistics
    np.testing.assert_equal(vars(subgoals.load(out)), vars(found[subgoals.OPEN]))
    assert found[subgoals.OPEN].along_mean > 2.0 and found[subgoals.OPEN].blocked == 0.0
    assert 0.0 < found[subgoals.ROOMS].blocked < 1.0
    assert postures.load(out / "postures.npz", robots.load("ant")).qpos.shape == (50, 15)
    assert (out / "subgoals.png").stat().st_size > 10_000
    assert found[subgoals.CORRIDORS].blocked == 0.0
    assert tables.of_subgoals(found, "ant").row_count == 15
    assert tables.of_drift(measured.drift, "ant").row_count == 6
    written = json.loads((out / subgoals.FILE).read_text())
    assert [row["num_subgoals"] for row in written[subgoals.DRIFT]] == [1, 10, 100] * 2

    # An ant on its back stays there.
    standing = written["standing"]
    assert standing["num_thrown"] == 10 > standing["num_down"] > 0
    assert standing["shares"]["4"] < 0.5
    assert tables.of_standing(measured.standing, "ant").row_count == 1
    with pytest.raises(base.UserError, match="not empty"):
        measurements.measure(options)


def test_too_few_subgoals_for_postures():
    with pytest.raises(base.UserError, match="num_subgoals = 100 must be at least 256"):
        measure_config.MeasureConfig(num_subgoals=100)


@pytest.mark.parametrize("text", ["", "{}", json.dumps({subgoals.OPEN: {"sigma": 1}})])
def test_damaged_figures_are_named(tmp_path, text):
    (tmp_path / subgoals.FILE).write_text(text)
    with pytest.raises(base.UserError, match=r"subgoals\.json can't be read"):
        subgoals.load(tmp_path)
