"""Comparisons with neighbours: who is compared with whom, and what is told. Nothing is timed."""

import itertools

import pytest

from eihrl_jax import base
from eihrl_jax.benchmarks import neighbours
from eihrl_jax.benchmarks.neighbours import Pair, Run


def test_speeds_are_compared_in_turns_and_what_is_not_there_is_told():
    """A clock that only runs while something is called: ours takes 1 s, theirs 2, 4 and 6 s."""
    now, slow = [0.0], itertools.cycle([9.0, 2.0, 4.0, 6.0])  # the first call compiles

    def takes(seconds):
        now[0] += seconds

    def absent():
        raise ImportError("No module named 'other'")

    figures = neighbours.compare(
        {"ours": lambda: Run(lambda: takes(1.0), 10), "unused": absent},
        [
            Pair("ours", "theirs", lambda: Run(lambda: takes(next(slow)), 5), "theirs"),
            Pair("ours", "other", absent, "other-py"),
            Pair("unused", "another", absent, "another-py"),
        ],
        repeats=3,
        clock=lambda: now[0],
    )
    assert figures[0] == {
        **{"ours": "ours", "theirs": "theirs", "our_rate": 10.0, "rate": 1.25},
        **{"ratio": 8.0, "least": 4.0, "greatest": 12.0},
    }
    assert neighbours.rows(figures) == {
        "ours against theirs": "8.00 times (4.00 to 12.00); 10 against 1/s",
        "ours against other": "not installed (other-py): No module named 'other'",
        "unused against another": "not installed (another-py): No module named 'other'",
    }


def test_a_checkout_that_is_none_is_named(tmp_path):
    with pytest.raises(base.UserError, match=r"jaxgcrl = .* holds no jaxgcrl/envs/ant_maze.py"):
        neighbours.ratios(tmp_path)
