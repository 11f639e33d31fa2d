"""Frames as a file that moves: GIF, or MP4 where the package for it is installed."""

import importlib
import pathlib
from collections.abc import Iterable

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from eihrl_jax import base
from eihrl_jax.drawing import palette
from eihrl_jax.storage import writing

FRAME_MILLISECONDS = 50
_LAST_FRAME_MILLISECONDS = 1800  # so that the end is seen before the loop begins anew
_TRANSPARENT = 255  # the last index of a palette
FORMATS = (".gif", ".mp4")
"""Endings of the files that can be written."""


def check(path: pathlib.Path) -> None:
    """Makes sure that a film can be written under this name.

    Raises:
      base.UserError: the name has another ending, or what writes such files isn't installed.
    """
    if path.suffix not in FORMATS:
        raise base.UserError(f"{path} must end in {' or '.join(FORMATS)}")
    if path.suffix == ".mp4":
        try:
            importlib.import_module("imageio_ffmpeg")
        except ImportError:
            text = "mp4 needs the package imageio-ffmpeg: pip install imageio-ffmpeg"
            raise base.UserError(text) from None


def save(path: pathlib.Path, frames: Iterable[UInt8[np.ndarray, "H W 3"]]) -> None:
    """Writes frames of one size as a film, whole or not at all.

    Args:
      path: where it goes; its ending tells the format.
      frames: one after the other.

    Raises:
      base.UserError: see `check`.
    """
    check(path)
    if path.suffix == ".mp4":
        # ffmpeg writes the file itself, and knows its format by its ending.
        temporary = writing.temporary_of(path)
        try:
            _save_mp4(temporary, frames)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    else:
        _save_gif(path, [Image.fromarray(frame) for frame in frames])


def _save_gif(path: pathlib.Path, frames: list[Image.Image]) -> None:
    """Writes a GIF that plays again and again."""
    # One palette for all frames keeps what does not move identical, and so out of the file.
    colours = _common_palette(frames)
    indexed = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    duration = [FRAME_MILLISECONDS] * (len(indexed) - 1) + [_LAST_FRAME_MILLISECONDS]
    with writing.new_file(path) as file:
        indexed[0].save(
            file,
            "GIF",
            save_all=True,
            append_images=indexed[1:],
            duration=duration,
            loop=0,
            # What doesn't change is left transparent, and the palette stands in the file once.
            optimize=True,
            transparency=_TRANSPARENT,
            palette=colours.getpalette(),
        )


def _save_mp4(path: pathlib.Path, frames: Iterable[UInt8[np.ndarray, "H W 3"]]) -> None:
    """Writes an MP4, H.264, whose last frame stays for as long as a GIF's."""
    write_frames = importlib.import_module("imageio_ffmpeg").write_frames
    writer = None
    frame = np.zeros((2, 2, 3), np.uint8)
    try:
        for frame in frames:
            if writer is None:
                height, width = frame.shape[:2]
                fps = 1000 / FRAME_MILLISECONDS
                writer = write_frames(
                    str(path), (width, height), fps=fps, quality=8, macro_block_size=2
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(frame))
        for _ in range(_LAST_FRAME_MILLISECONDS // FRAME_MILLISECONDS - 1):
            if writer is not None:
                writer.send(np.ascontiguousarray(frame))
    finally:
        if writer is not None:
            writer.close()


def _common_palette(frames: list[Image.Image]) -> Image.Image:
    """Returns an image with the palette of an animation.

    It is made from a few of the frames, and from swatches of those colours that cover too little
    of them to be given a place of their own.
    """
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, 4).astype(int)]
    width, height = chosen[0].size

    montage = Image.new("RGB", (width, height * (len(chosen) + 1)))
    for i, frame in enumerate(chosen):
        montage.paste(frame, (0, i * height))

    # Shades from half to full light, as the shading makes them.
    names = (palette.GOAL, palette.GOAL_ACHIEVED, palette.ROBOT, palette.ROBOT_LIMB, palette.TRAIL)
    shades = np.linspace(0.5, 1.0, 8)
    swatches = np.array([[255 * shade * palette.rgb(name) for shade in shades] for name in names])
    swatch = Image.fromarray(swatches.astype(np.uint8))
    montage.paste(
        swatch.resize((width, height), Image.Resampling.NEAREST), (0, height * len(chosen))
    )
    return montage.quantize(_TRANSPARENT, method=Image.Quantize.MEDIANCUT)
