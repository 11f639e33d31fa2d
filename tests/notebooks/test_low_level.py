"""A slow test: the tests of the low level's training and of the facade run all of this too."""

import pytest

from tests.notebooks import files


@pytest.mark.slow
def test_the_notebook_runs():
    files.run("low_level")
