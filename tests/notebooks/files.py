"""The notebooks: where they are, what is in them, and how one is run."""

import os
import pathlib

import nbclient
import nbformat

FOLDER = pathlib.Path(__file__).parents[2] / "notebooks"
NAMES = sorted(file.stem for file in FOLDER.glob("*.ipynb"))
CELL_SECONDS = 300


def path(name):
    return FOLDER / f"{name}.ipynb"


def read(name):
    notebook = nbformat.read(path(name), as_version=4)
    nbformat.validate(notebook)
    return notebook


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def run(name):
    """Runs a notebook in its fast mode, and asserts that all of its cells have been run."""
    # The kernel gets the environment alone, so the strict settings of these tests don't hold in it.
    client = nbclient.NotebookClient(
        read(name),
        timeout=CELL_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(FOLDER)}},
    )
    client.execute(env=os.environ | {"EIHRL_FAST": "1", "JAX_PLATFORMS": "cpu"})
    assert all(cell.execution_count for cell in code_cells(client.nb))
