"""Reads occupancy grids from pictures, and from maps of ROS's map_server (YAML and a picture).

Pixels are grouped into cells. A cell is a wall if an obstacle, inflated by the robot's radius,
reaches into it, so that a robot may be anywhere in a free cell. The grid is cropped to the bounding
box of the free cells. Nothing in a file is executed, and sizes are checked before anything is
decoded.

Source: wiki.ros.org/map_server for the YAML's fields and the meaning of brightness.
"""

import dataclasses
import io
import math
import pathlib
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import yaml
from jaxtyping import Bool, Float
from PIL import Image
from scipy import ndimage

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.config import reading as reading_config
from eihrl_jax.mazes import parsing
from eihrl_jax.mazes.readers import plan as plan_lib
from eihrl_jax.storage import reading

MAX_PIXELS = 2**24
"""Most pixels of a picture."""

MAX_BYTES = 8 * MAX_PIXELS
"""Largest size of a picture's file."""

MAX_YAML_BYTES = 2**16

MAX_YAML_DEPTH = 20
"""Most nested brackets: the time that YAML takes grows with their square."""

FORMATS = {
    b"\x89PNG\r\n\x1a\n": "PNG",
    **{b"P" + digit: "PPM" for digit in (b"1", b"2", b"3", b"4", b"5", b"6")},
    b"\xff\xd8\xff": "JPEG",
    b"BM": "BMP",
}
"""Formats that are read, as Pillow calls them (PGM and PBM are PPM), by their first bytes."""

OTHER_FORMATS = {
    b"GIF8": "GIF",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"RIFF": "WebP",
    b"%PDF": "PDF",
    b"\0\0\1\0": "ICO",
    b"8BPS": "PSD",
}
"""Formats that are recognised, so that the error can name them, but not read."""

_OPENING = (yaml.FlowSequenceStartToken, yaml.FlowMappingStartToken)
_CLOSING = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken)

_OCCUPIED, _FREE = 0.65, 0.196  # map_server's defaults


class _Frame(NamedTuple):
    """The pose of the picture in the world.

    Attributes:
      resolution: metres per pixel; 0 if unknown.
      origin: x and y in metres and yaw in radians of the lower left corner.
    """

    resolution: float
    origin: tuple[float, float, float]


class _Thresholds(NamedTuple):
    """Thresholds of darkness, see `ReadingConfig`; raw mode and negate as in map_server."""

    occupied: float
    free: float
    is_raw: bool = False
    negate: bool = False


def of_picture(data: bytes, options: reading_config.ReadingConfig, name: str) -> plan_lib.Plan:
    """Reads a picture, in which dark pixels are obstacles.

    Args:
      data: the file's content.
      options: thresholds and scale.
      name: of the file, for messages.

    Raises:
      base.UserError: it isn't such a picture, or an option doesn't fit it.
    """
    occupied = _OCCUPIED if options.occupied is None else options.occupied
    free = _FREE if options.free is None else options.free
    frame = _Frame(options.metres_per_pixel, (0.0, 0.0, 0.0))
    return _of_pixels("picture", data, frame, _Thresholds(occupied, free), options, name)


def of_ros(
    text: str, path: pathlib.Path, options: reading_config.ReadingConfig, name: str
) -> plan_lib.Plan:
    """Reads a map of ROS's map_server.

    Args:
      text: the YAML.
      path: of the YAML's file, from which the path of the picture is relative.
      options: thresholds and scale, in place of the YAML's where they are given.
      name: of the file, for messages.

    Raises:
      base.UserError: YAML or picture are malformed, or an option doesn't fit them.
    """
    fields = _yaml(text, name)
    image, mode = fields.get("image"), fields.get("mode", "trinary")
    if not isinstance(image, str) or not image or "\0" in image:
        raise base.UserError(f"{name}: not a map of map_server: the YAML names no image")
    if mode not in ("trinary", "scale", "raw"):
        raise base.UserError(f"{name}: mode = {mode!r} must be one of trinary, scale, raw")

    resolution = _number(fields, "resolution", name)
    checks.in_range(f"{name}: resolution", resolution, above=0.0, high=1_000.0)
    origin = fields.get("origin", [0.0, 0.0, 0.0])
    if not isinstance(origin, list) or len(origin) != 3:
        raise base.UserError(f"{name}: origin = {str(origin)[:40]!r} must be x, y and yaw")
    x, y, yaw = (_number({"origin": n}, "origin", name) for n in origin)

    negate = fields.get("negate", 0)
    if negate not in (0, 1):
        raise base.UserError(f"{name}: negate = {str(negate)[:40]!r} must be 0 or 1")
    occupied, free = options.occupied, options.free
    if occupied is None:
        occupied = _number(fields, "occupied_thresh", name, _OCCUPIED)
    if free is None:
        free = _number(fields, "free_thresh", name, _FREE)
    thresholds = _Thresholds(occupied, free, mode == "raw", bool(negate))

    beside = path.parent / image
    try:
        data = reading.read_bytes(beside, limit=MAX_BYTES)
    except OSError as error:
        raise base.UserError(f"{name}: image {image!r}: {error.strerror}") from None
    frame = _Frame(resolution, (x, y, yaw))
    return _of_pixels("ROS map", data, frame, thresholds, options, f"{name}: image {image!r}")


def format_of(data: bytes, name: str) -> str | None:
    """Returns the format of a picture by its first bytes; None if it isn't a picture.

    Raises:
      base.UserError: it has a format that isn't read.
    """
    for start, kind in FORMATS.items():
        # A text file may begin with "P1" too: in a picture a blank follows.
        if data.startswith(start) and (kind != "PPM" or data[2:3].isspace()):
            return kind
    for start, kind in OTHER_FORMATS.items():
        if data.startswith(start):
            raise base.UserError(
                f"{name}: a picture in format {kind}, must be PNG, PGM, PBM, PPM, JPEG or BMP"
            )
    return None


def _of_pixels(
    kind: str,
    data: bytes,
    frame: _Frame,
    thresholds: _Thresholds,
    options: reading_config.ReadingConfig,
    name: str,
) -> plan_lib.Plan:
    """Turns a picture into cells."""
    checks.in_range(f"{name}: occupied_thresh", thresholds.occupied, 0.0, 1.0)
    checks.in_range(f"{name}: free_thresh", thresholds.free, 0.0, 1.0)
    if thresholds.free > thresholds.occupied:
        raise base.UserError(
            f"{name}: free_thresh = {thresholds.free} must be at most occupied_thresh = "
            f"{thresholds.occupied}"
        )
    if options.robot_radius and not frame.resolution:
        raise base.UserError(
            f"{name}: robot_radius = {options.robot_radius} m needs metres_per_pixel"
        )

    obstacle = _obstacles(_pixels(data, name), thresholds, options.unknown == "free")
    side = 1.0
    if frame.resolution:
        # Distances are between pixel centres: an obstacle's edge is half a pixel nearer. Padding
        # makes everything outside of the picture an obstacle.
        radius = options.robot_radius / frame.resolution
        if radius:
            distance = np.asarray(ndimage.distance_transform_edt(np.pad(~obstacle, 1)))
            obstacle = distance[1:-1, 1:-1] < radius + 0.5
        side = options.cell_metres / frame.resolution
        if side < 1.0:
            raise base.UserError(
                f"{name}: cell_metres = {options.cell_metres} must be at least a pixel's "
                f"{frame.resolution:g}"
            )
    free = _cells(obstacle, side, name)

    # Cropped to what is free: maps of ROS often have a small room amid a large unknown area.
    rows, columns = np.flatnonzero(free.any(1)), np.flatnonzero(free.any(0))
    if not len(rows):
        raise base.UserError(f"{name}: no free cell")
    box = free[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    plan = plan_lib.of_free(kind, box, always_ringed=True, name=name)
    first = (int(1 - rows[0]), int(1 - columns[0]))

    def from_metres(x: float, y: float) -> tuple[float, float]:
        """Returns row and column, in cells, of a position in metres."""
        x0, y0, yaw = frame.origin
        across, up = x - x0, y - y0
        column = math.cos(yaw) * across + math.sin(yaw) * up
        height = -math.sin(yaw) * across + math.cos(yaw) * up
        # The grid of cells begins in the lower left corner, but rows are counted from above.
        row = free.shape[0] - height / frame.resolution / side
        return row + first[0], column / frame.resolution / side + first[1]

    known = from_metres if frame.resolution else None
    return dataclasses.replace(plan, first=first, from_metres=known)


def _pixels(data: bytes, name: str) -> tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Decodes a picture to brightness in [0, 255] and which pixels are transparent."""
    kind = format_of(data, name)
    if kind is None:
        raise base.UserError(f"{name}: not a picture in format PNG, PGM, PBM, PPM, JPEG or BMP")

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, which are refused below
            picture = Image.open(io.BytesIO(data), formats=[kind])
            width, height = picture.size
            if not 1 <= width * height <= MAX_PIXELS:
                raise base.UserError(
                    f"{name}: {width} x {height} pixels, must be at most {MAX_PIXELS} in all"
                )
            picture.load()
            return _brightness(picture)
    except base.UserError:
        raise
    except Image.DecompressionBombError:
        raise base.UserError(f"{name}: more pixels than {MAX_PIXELS}") from None
    except Exception as error:  # Pillow raises errors of many types for damaged files.
        raise base.UserError(f"{name}: a damaged picture: {_one_line(error)}") from None


def _brightness(
    picture: Image.Image,
) -> tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Returns brightness in [0, 255], the mean over colours, and which pixels are transparent."""
    if picture.mode.startswith("I") or picture.mode == "F":  # 16 bits
        value = np.asarray(picture, np.float32) / 257.0
        return value, np.zeros(value.shape, bool)
    # Conversion to RGBA handles transparency in every mode.
    pixels = np.asarray(picture.convert("RGBA"))
    return pixels[..., :3].mean(-1, dtype=np.float32), pixels[..., 3] < 128


def _obstacles(
    pixels: tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]],
    thresholds: _Thresholds,
    unknown_is_free: bool,
) -> Bool[np.ndarray, "H W"]:
    """Returns which pixels are obstacles."""
    value, is_clear = pixels
    if thresholds.is_raw:  # occupancy in per cent; values above 100 are unknown
        darkness, is_clear = value / 100.0, is_clear | (value > 100.0)
    else:
        darkness = value / 255.0 if thresholds.negate else 1.0 - value / 255.0
    if unknown_is_free:
        return (darkness > thresholds.occupied) & ~is_clear
    return (darkness >= thresholds.free) | is_clear


def _cells(obstacle: Bool[np.ndarray, "H W"], side: float, name: str) -> Bool[np.ndarray, "R C"]:
    """Returns which cells of `side` pixels are free; the grid begins in the lower left corner."""
    height, width = obstacle.shape
    rows, columns = (max(1, math.floor(size / side + 1e-9)) for size in (height, width))
    if max(rows, columns) > parsing.MAX_SIZE:
        raise base.UserError(
            f"{name}: {rows} x {columns} cells, must be at most {parsing.MAX_SIZE} x "
            f"{parsing.MAX_SIZE}; larger cells need metres_per_pixel and cell_metres"
        )

    # Obstacles per cell from a summed-area table; a pixel that two cells share counts in both.
    total = np.pad(obstacle.cumsum(0, dtype=np.int32).cumsum(1, dtype=np.int32), ((1, 0), (1, 0)))
    top = [height - side * (rows - i) for i in range(rows)]
    left = [side * j for j in range(columns)]
    i0, i1 = _pixel_range(top, side, height)
    j0, j1 = _pixel_range(left, side, width)
    within = total[np.ix_(i1, j1)] - total[np.ix_(i0, j1)] - total[np.ix_(i1, j0)]
    return within + total[np.ix_(i0, j0)] == 0


def _pixel_range(starts: list[float], side: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns first and last pixel (exclusive) of cells that start at some pixel coordinates."""
    first = np.floor(np.array(starts) + 1e-6).astype(int)
    last = np.ceil(np.array(starts) + side - 1e-6).astype(int)
    return first.clip(0, size), last.clip(0, size)


def _yaml(text: str, name: str) -> Mapping[str, Any]:
    """Reads plain YAML: no tags, which could create objects, and no aliases, which could explode.

    Raises:
      base.UserError: it isn't such YAML, or too large or too deeply nested.
    """
    if len(text) > MAX_YAML_BYTES:
        raise base.UserError(f"{name}: YAML of {len(text)} characters, at most {MAX_YAML_BYTES}")

    # Scanned token by token, so that hostile content is refused before anything is built from it.
    depth = 0
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if isinstance(token, yaml.TagToken | yaml.AnchorToken | yaml.AliasToken):
                line = token.start_mark.line + 1
                raise base.UserError(
                    f"{name}: YAML has a tag, anchor or alias at line {line}; none is allowed"
                )
            depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
            if depth > MAX_YAML_DEPTH:
                raise base.UserError(f"{name}: YAML is nested more than {MAX_YAML_DEPTH} deep")
        fields = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise base.UserError(f"{name}: not YAML: {_one_line(error)}") from None
    except (RecursionError, ValueError, OverflowError) as error:
        if isinstance(error, base.UserError):
            raise
        raise base.UserError(f"{name}: not YAML of a map: {_one_line(error)}") from None
    if not isinstance(fields, dict):
        raise base.UserError(f"{name}: not a map of map_server: the YAML has no fields")
    return fields


def _number(
    fields: Mapping[str, Any], field: str, name: str, default: float | None = None
) -> float:
    """Returns a finite number of the YAML, or raises `base.UserError`."""
    value = fields.get(field, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise base.UserError(f"{name}: {field} = {str(value)[:40]!r} must be a number")
    return float(value)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
