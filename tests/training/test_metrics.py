"""Rows of metrics: means over episodes, and none where those that ended don't stand for all."""

import math

import numpy as np
import pytest

from eihrl_jax.training import metrics


@pytest.mark.parametrize(
    ("begin", "end", "is_fair"),
    [(0, 24, False), (12, 36, False), (24, 30, True), (0, 120, True)],
)
def test_first_rows_would_count_only_episodes_that_ended_early(begin, end, is_fair):
    assert metrics.is_fair(begin, end, limit=24) == is_fair


def test_episodes_that_do_not_stand_for_all_have_no_mean():
    found = {"sum_success": np.array([1.0, 2.0]), "episodes": np.array([1.0, 3.0]), "loss": 2.0}
    assert metrics.summarise(found) == {"success": 0.75, "loss": 2.0}
    early = metrics.summarise(found, is_fair=False)
    assert math.isnan(early["success"])
    assert early["loss"] == 2.0
