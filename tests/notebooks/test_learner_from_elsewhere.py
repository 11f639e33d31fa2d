"""Runs where the learner is installed, which the lock file leaves out."""

import pytest

from tests.notebooks import files

pytest.importorskip("stable_baselines3")


def test_the_notebook_runs():
    files.run("learner_from_elsewhere")
