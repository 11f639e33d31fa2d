"""Figures show text as it is, and are written whole or not at all."""

import numpy as np
import pytest
from PIL import Image

from eihrl_jax.drawing import figures


@pytest.mark.parametrize("name", ["cost$a_^b$", r"\frac{", "50%", "迷路", "a\udcff\x1b[0m\tb"])
def test_names_are_no_formulas(name, tmp_path):
    figure = figures.new(3.0, 2.0)
    axes = figure.add_subplot()
    axes.plot([1, 100], [1, 2], label=name)
    axes.set_title(name)
    axes.set_xscale("log")
    figure.legend()
    figures.label(axes, name, "y")
    figures.save(figure, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert np.asarray(image).min() < 200
    # Powers of ten are.
    assert axes.xaxis.get_ticklabels()[1].get_parse_math()


def test_what_fails_leaves_no_half_a_picture(tmp_path, capsys):
    path = tmp_path / "a.png"

    def draw():
        with figures.writing.new_file(path) as file:
            file.write(b"half")
            raise OSError(28, "No space left on device")

    figures.attempt(path, draw)
    assert not any(tmp_path.iterdir())
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {path} couldn't be drawn: ") and "No space left" in line
