from tests.notebooks import files


def test_the_notebook_runs():
    files.run("bounds")
