"""A slow test: the tests of evaluations and of shipped policies evaluate all of this too."""

import pytest

from tests.notebooks import files


@pytest.mark.slow
def test_the_notebook_runs():
    files.run("zero_shot")
