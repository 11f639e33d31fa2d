"""Opens untrusted MJCF files: files that they name must lie in their folder or below.

MuJoCo reads whatever a file names, from wherever it says, and would wait for a pipe for ever. Its
parser knows no entities but XML's own, and runs nothing.
"""

import html
import itertools
import pathlib
import re

import mujoco

from eihrl_jax import base
from eihrl_jax.storage import reading

MAX_BYTES = 2**24
"""Largest MJCF file."""

MAX_ASSET_BYTES = 2**28
"""Largest file that one names: a mesh, a texture, a height field."""

MAX_FILES = 100
"""Most MJCF files that include each other."""

_NAMED = re.compile(rb"""\b(file\w*|\w+dir)\s*=\s*(["'])(.*?)\2""", re.DOTALL)
_XML = (".xml", ".mjcf", ".urdf")


def load(path: pathlib.Path) -> mujoco.MjSpec:
    """Reads an MJCF or URDF file.

    Args:
      path: of the file.

    Raises:
      base.UserError: it is too large or no regular file, or names a file elsewhere.
      ValueError: MuJoCo can't read it.
      OSError: it isn't there.
    """
    files(path)
    return mujoco.MjSpec.from_file(str(path))


def files(path: pathlib.Path) -> list[pathlib.Path]:
    """Lists an MJCF file, those that it includes, and whatever else they name, after checking them.

    Raises:
      base.UserError, OSError: see `load`.
    """
    waiting, seen = [path], {path}
    while waiting:
        data = reading.read_bytes(waiting.pop(), limit=MAX_BYTES)
        named = {kind: set() for kind in ("dir", "file")}
        for attribute, _, value in _NAMED.findall(data):
            kind = "dir" if attribute.endswith(b"dir") else "file"
            named[kind].add(_inside(value.decode("utf-8", "replace")))

        # As MuJoCo looks for them: beside the first file, or in the folder for their kind.
        for folder, name in itertools.product({pathlib.PurePath(), *named["dir"]}, named["file"]):
            file = path.parent / folder / name
            if not file.exists() or file in seen:
                continue
            seen.add(file)
            if not file.is_file() or file.stat().st_size > MAX_ASSET_BYTES:
                raise base.UserError(f"it names {str(name)!r:.80}, which is no file to be read")
            if file.suffix in _XML:
                waiting.append(file)
        if len(waiting) > MAX_FILES:
            raise base.UserError(f"it includes more than {MAX_FILES} files")
    return sorted(seen)


def _inside(value: str) -> pathlib.PurePath:
    """Returns a name that an MJCF file has for another, which must not lead out of its folder."""
    # MuJoCo's parser puts in the characters that are told by their numbers, and MuJoCo itself takes
    # either slash.
    name = pathlib.PurePath(html.unescape(value).replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts:
        raise base.UserError(
            f"it names {value!r:.80}: what belongs to a robot lies in its folder or below"
        )
    return name
