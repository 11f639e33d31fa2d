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
from PIL import Image, ImageSequence

FOLDER = pathlib.Path(__file__).parent
COLOURS = 64
"""Of a picture: plots and rendered mazes look the same with so few, and are a third as large."""
STEP = 4
"""Every fourth frame of an animation is kept, at half its width and height."""


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
    """Drops lines of progress, which differ from run to run, and makes pictures smaller."""
    for cell in notebook.cells:
        outputs = cell.get("outputs", [])
        if outputs:
            cell.outputs = [output for output in outputs if not _is_progress(output)]
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"])))
                small = io.BytesIO()
                picture.convert("RGB").quantize(COLOURS).save(small, "PNG", optimize=True)
                data["image/png"] = base64.b64encode(small.getvalue()).decode()
            if "image/gif" in data:
                data["image/gif"] = _smaller_film(data["image/gif"])


def _is_progress(output: nbformat.NotebookNode) -> bool:
    """Returns whether an output is a line that a progress bar has printed."""
    return output.output_type == "display_data" and set(output.data) == {"text/html", "text/plain"}


def _smaller_film(encoded: str) -> str:
    """Returns a GIF with fewer, smaller frames, in base64, at the same speed."""
    film = Image.open(io.BytesIO(base64.b64decode(encoded)))
    pictures, durations = [], []
    for number, frame in enumerate(ImageSequence.Iterator(film)):
        if number % STEP == 0:
            size = film.width // 2, film.height // 2
            pictures.append(frame.convert("RGB").resize(size))
            durations.append(0)
        durations[-1] += frame.info["duration"]

    # One palette without dithering, so that what doesn't move isn't stored again.
    ends = Image.new("RGB", (film.width, film.height // 2))
    ends.paste(pictures[0], (0, 0))
    ends.paste(pictures[-1], (film.width // 2, 0))
    palette = ends.quantize(COLOURS)
    frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    for frame in frames:
        frame.info = {}  # has a transparent colour of the original's palette

    file = io.BytesIO()
    options = {"append_images": frames[1:], "duration": durations, "loop": 0, "optimize": True}
    frames[0].save(file, "GIF", save_all=True, **options)
    return base64.b64encode(file.getvalue()).decode()


if __name__ == "__main__":
    main(sys.argv[1:])
