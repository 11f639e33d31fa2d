"""Predictions from laws of end points: against sums by hand, and their files."""

import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs import end_points
from eihrl_jax.evaluation import end_law, loading, prediction

CORRIDOR = "decisions 5\njitter 0\n######\n#S..1#\n######\n"
"""Three moves to the east, of five decisions."""

FORKED = "decisions 4\njitter 0\n#####\n#2.S1\n#####\n"
"""A goal next to the start, and another three moves from there."""


def _law(*rows):
    """End points of (condition, cells along, whether down), each as often as it stands there."""
    condition, along, is_down = (np.array(column) for column in zip(*rows, strict=True))
    return end_points.EndPoints(
        condition, base.CELL * along.astype(float), np.full(len(rows), 0.1), is_down > 0
    )


def _predicted(tmp_path, text, law, **options):
    path = tmp_path / "maze.txt"
    path.write_text(text)
    chosen = {"maze": mazes.load(path)}
    high = loading.load_high("shortest")
    point = robots.load("point")
    return prediction.Predictor(point, high, chosen, law, anchored=True, **options).run("maze")


def test_a_robot_that_sometimes_stays_where_it_is(tmp_path):
    """Moves succeed with 0.9, the first one with 0.5: sums over when the third one does."""
    rest = [(end_points.REST, 1, 0), (end_points.REST, 0, 0)]
    law = _law(*rest, *[(end_points.AHEAD, cells, 0) for cells in (1,) * 9 + (0,)])
    found = _predicted(tmp_path, CORRIDOR, law)
    in_three = 0.5 * 0.9**2
    in_four = 0.5 * 0.9**3 + 0.5 * 2 * 0.9**2 * 0.1
    in_five = 0.5 * 3 * 0.9**3 * 0.1 + 0.5 * 3 * 0.9**2 * 0.1**2
    assert found.success == found.solved == pytest.approx(in_three + in_four + in_five, abs=1e-6)
    assert found.decisions == pytest.approx(5 - 2 * in_three - in_four, abs=1e-6)
    assert (found.thinned, found.down) == (0.0, 0.0)
    assert found.num_states == 3  # one for each cell


def test_a_robot_that_falls_and_stands_up_again(tmp_path):
    """A tenth of the moves is a fall on the spot; half of those lying stand up."""
    up = [(condition, 1, 0) for condition in (end_points.REST, end_points.AHEAD)] * 9
    falls = [(end_points.REST, 0, 1), (end_points.AHEAD, 0, 1)]
    law = _law(*up, *falls, (end_points.DOWN, 0, 1), (end_points.DOWN, 0, 0))
    found = _predicted(tmp_path, CORRIDOR, law)
    # Without a fall; with one, before any of the three moves, and up at once, which takes 5.
    assert found.success == pytest.approx(0.9**3 + 3 * 0.1 * 0.5 * 0.9**3, abs=1e-6)
    # On the ground after five decisions, by the number of moves that had succeeded.
    fall, stand, move = 0.1, 0.5, 0.9
    state = {(0, False): 1.0}
    for _ in range(5):
        after = {}
        for (cell, is_down), mass in state.items():
            if is_down:
                ways = (((cell, True), 1 - stand), ((cell, False), stand))
            else:
                ways = (((cell, True), fall), ((cell + 1, False), move))
            for key, share in ways:
                if key[0] < 3:
                    after[key] = after.get(key, 0.0) + mass * share
        state = after
    down = sum(mass for (_, is_down), mass in state.items() if is_down)
    assert found.down == pytest.approx(down, abs=1e-6)


def test_goals_count_one_by_one_and_walls_stop(tmp_path):
    """The near goal is always reached, the far one only where no move of three fails."""
    kinds = [end_points.REST, end_points.AHEAD, end_points.BEHIND]
    law = _law(*[(kind, cells, 0) for kind in kinds for cells in (1, 1, 1, 0)])
    found = _predicted(tmp_path, FORKED, law)
    first = 1 - 0.25**4
    assert found.solved == pytest.approx(0.75**4, abs=1e-6)
    assert found.success == pytest.approx((first + found.solved) / 2, abs=1e-6)


def test_thinning_keeps_the_great_and_is_right_on_average():
    mass = np.array([0.4, 0.3, 0.1, 0.08, 0.07, 0.05])
    columns = [np.zeros((6, 2), np.int32), np.zeros((6, 9), bool), np.zeros((6, 0, 0), bool)]
    states = prediction._States(
        *columns,
        np.arange(12.0).reshape(6, 2).astype(np.float32),
        np.arange(6, dtype=np.int32),
        mass,
    )
    rng, sums = np.random.default_rng(0), np.zeros(6)
    for _ in range(1_000):
        kept, drawn = prediction._thinned(states, 4, rng)
        assert len(kept.mass) == 4 and kept.mass.sum() == pytest.approx(1.0)
        assert kept.before[:2].tolist() == [0, 1] and kept.mass[:2].tolist() == [0.4, 0.3]
        assert drawn == pytest.approx(0.3)
        np.add.at(sums, kept.before, kept.mass)
    np.testing.assert_allclose(sums / 1_000, mass, atol=0.01)
    assert mass[2] == 0.1  # what was given is as it was


def test_a_law_takes_together_what_ends_on_one_side_of_a_cells_middle():
    ends = end_points.EndPoints(
        np.full(4, end_points.AHEAD),
        np.array([2.8, 2.6, 3.2, 3.2]),
        np.array([0.1, 0.3, 0.1, -0.1]),
        np.array([False, False, False, True]),
    )
    law = end_law.Law.of(ends, base.CELL / 2)
    groups = {
        tuple(np.round(np.array(group, float), 4))
        for group in zip(
            *(np.asarray(x)[end_points.AHEAD] for x in vars(law).values()), strict=True
        )
    }
    assert groups == {(0.5, 2.7, 0.2, 0.0), (0.25, 3.2, 0.1, 0.0), (0.25, 3.2, -0.1, 1.0)}
    # Turns that were never seen are as any; who lies on the ground stays there.
    np.testing.assert_allclose(law.weight[end_points.LEFT], law.weight[end_points.AHEAD])
    assert bool(law.is_down[end_points.DOWN, 0]) and float(law.weight[end_points.DOWN, 0]) == 1.0
