"""Runs notebooks as a whole and keeps their outputs, pictures small: `make notebooks`.

`python notebooks/keep_outputs.py NAME …` runs some of them. `EIHRL_FAST` must not be set.
"""

import base64
import io
import os
import pathlib
import sys

import nbclient
import nbformat
from PIL import Image

FOLDER = pathlib.Path(__file__).parent
COLOURS = 64
"""Of a picture: plots and rendered mazes look the same with so few, and are a third as large."""


def main(names: list[str]) -> None:
    """Runs the named notebooks, or all."""
    for name in names or sorted(file.stem for file in FOLDER.glob("*.ipynb")):
        notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
        # Without times, which would differ from run to run.
        nbclient.NotebookClient(
            notebook,
            timeout=3600,
            kernel_name="python3",
            record_timing=False,
            resources={"metadata": {"path": str(FOLDER)}},
        ).execute(env=os.environ | {"JAX_PLATFORMS": "cpu"})
        shrink(notebook)
        nbformat.write(notebook, FOLDER / f"{name}.ipynb")


def shrink(notebook: nbformat.NotebookNode) -> None:
    """Reduces the colours of a notebook's pictures."""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"])))
                small = io.BytesIO()
                picture.convert("RGB").quantize(COLOURS).save(small, "PNG", optimize=True)
                data["image/png"] = base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    main(sys.argv[1:])
