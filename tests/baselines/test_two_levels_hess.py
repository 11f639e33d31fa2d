"""HESS finds its way on open floor, see `test_two_levels`."""

from tests.baselines.test_two_levels import (  # noqa: F401
    pytest_generate_tests,
    test_both_levels_together_learn_to_walk_straight_to_any_goal,
)

METHODS = ("hess",)
