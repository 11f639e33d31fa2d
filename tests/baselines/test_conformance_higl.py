"""HIGL conforms, see `test_conformance`; HRAC and HIRO, parts of HIGL, are among the slow tests."""

import pytest

from tests.baselines.test_conformance import (  # noqa: F401
    arena,
    finished,
    maze,
    pytest_generate_tests,
    settings,
    test_a_baseline_is_evaluated_beside_ours,
    test_a_baseline_needs_its_robot_and_walking,
    test_advancing_keeps_all_types_so_that_it_compiles_once,
    test_metrics_are_numbers_and_episodes_are_counted,
    test_resuming_changes_nothing,
)

METHODS = (
    "higl",
    pytest.param("hrac", marks=pytest.mark.slow),
    pytest.param("hiro", marks=pytest.mark.slow),
)
