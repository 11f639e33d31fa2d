import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.config import gallery as gallery_config
from eihrl_jax.drawing import montage
from eihrl_jax.reporting import gallery


def film(shades):
    return [np.full((4, 6, 3), shade, np.uint8) for shade in shades]


def shown(page, i):
    """What is in the middle of the i-th picture of a grid of two columns."""
    height, width = 4 + 2 * montage.MARGIN, 6 + 2 * montage.MARGIN
    return page[(i // 2) * height + height // 2, (i % 2) * width + width // 2, 0]


def test_films_run_at_one_pace_and_wait_for_the_longest():
    films = [film([1, 2]), film(range(10, 17)), film([90])]
    pages = list(montage.side_by_side(films, 4))
    assert [shown(page, 1) for page in pages] == [10, 12, 14, 16]
    assert [shown(page, 0) for page in pages] == [1, 2, 2, 2]
    assert {shown(page, 2) for page in pages} == {90}
    # Nobody is in the fourth place.
    assert pages[0].shape == (2 * (4 + 2 * montage.MARGIN), 2 * (6 + 2 * montage.MARGIN), 3)
    assert shown(pages[0], 3) == 255


def test_pictures_keep_their_proportion():
    assert montage.resized(np.full((20, 40, 3), 7, np.uint8), 10).shape == (5, 10, 3)


def test_nothing_is_overwritten(tmp_path):
    there = tmp_path / "there.gif"
    there.touch()
    with pytest.raises(base.UserError, match=r"there\.gif exists already"):
        gallery.draw(gallery_config.GalleryConfig(out=there))
