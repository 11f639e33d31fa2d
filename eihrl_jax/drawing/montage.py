"""Several films side by side."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image

Frame = UInt8[np.ndarray, "H W 3"]

MARGIN = 6
"""Pixels around each picture."""

_BACKGROUND = 255


def side_by_side(films: Sequence[Sequence[Frame]], num_frames: int) -> Iterator[Frame]:
    """Yields the frames of one film that shows several on a grid.

    Args:
      films: frames of one size, each film of its own length.
      num_frames: at most; of longer films every second, third, … frame is shown, of all the same.

    >>> dark, bright = np.zeros((1, 2, 2, 3), np.uint8), np.full((5, 2, 2, 3), 9, np.uint8)
    >>> len(list(side_by_side([list(dark), list(bright)], 3)))
    3
    """
    longest = max(map(len, films))
    stride = -(-longest // num_frames)
    columns = math.ceil(math.sqrt(len(films)))
    rows = -(-len(films) // columns)
    height, width = films[0][0].shape[:2]
    cell_height, cell_width = height + 2 * MARGIN, width + 2 * MARGIN

    # The end is always shown, as all films stop there.
    for moment in [*range(0, longest - 1, stride), longest - 1]:
        page = np.full((rows * cell_height, columns * cell_width, 3), _BACKGROUND, np.uint8)
        for i, film in enumerate(films):
            y = (i // columns) * cell_height + MARGIN
            x = (i % columns) * cell_width + MARGIN
            page[y : y + height, x : x + width] = film[min(moment, len(film) - 1)]
        yield page


def resized(frame: Frame, width: int) -> UInt8[np.ndarray, "height width 3"]:
    """Returns a picture of another width, height in proportion."""
    height = round(frame.shape[0] * width / frame.shape[1])
    image = Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS)
    return np.asarray(image)
