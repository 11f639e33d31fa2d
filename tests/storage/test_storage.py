"""Files of strangers are read within limits, and our own are written whole and through no link."""

import errno
import io
import os
import zipfile

import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.storage import archives, reading, writing


def test_bytes_and_texts_come_back(tmp_path):
    path = tmp_path / "a.txt"
    writing.write_text(path, "Größe\n")
    assert reading.read_text(path) == "Größe\n"
    path.write_bytes(b"\xef\xbb\xbfmarked")
    assert reading.read_text(path, limit=9) == "marked"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_only_regular_files_are_read(tmp_path, make):
    make(tmp_path / "odd")
    with pytest.raises(base.UserError, match=r"odd is no regular file$"):
        reading.read_bytes(tmp_path / "odd")


def test_devices_and_large_files_are_refused(tmp_path):
    with pytest.raises(base.UserError, match="/dev/zero is no regular file"):
        reading.read_bytes(tmp_path / "/dev/zero")
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(base.UserError, match="large has 1000000000000 bytes, at most 100"):
        reading.read_bytes(path, limit=100)
    with pytest.raises(base.UserError, match="at most 10$"):
        reading.read_bytes(tmp_path / "/proc/self/maps", limit=10)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": ', "f is no JSON"),
        ("[" * 100 + "]" * 100, "f is nested more than 64 deep"),
        ("[" * 100_000 + "]" * 100_000, "f is nested more than 64 deep"),
        ("9" * 400, f"f: an integer is beyond {2**63 - 1}"),
        ("9" * 5_000, "f is no JSON"),
        ('[{"a": -9223372036854775808}]', "f: an integer is beyond"),
    ],
)
def test_odd_json_is_told_in_one_line(text, message):
    with pytest.raises(base.UserError, match=message) as error:
        reading.parse_json(text, "f")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a = ", "is no TOML"),
        (b"\xff", "is no text in UTF-8: byte 0"),
        (b"a = " + b"[" * 2_000 + b"]" * 2_000, "is nested more than 64 deep"),
        (b"a = " + b"9" * 400, "an integer is beyond"),
    ],
)
def test_odd_toml_is_told_in_one_line(tmp_path, data, message):
    path = tmp_path / "f.toml"
    path.write_bytes(data)
    with pytest.raises(base.UserError, match=message):
        reading.read_toml(path)


def test_json_and_toml_that_are_sound(tmp_path):
    assert reading.parse_json('{"a": [1, 2.5, null]}', "f") == {"a": [1, 2.5, None]}
    path = tmp_path / "f.toml"
    path.write_bytes(b'a = "b"\r\n[c]\r\nd = 1\r\n')
    assert reading.read_toml(path) == {"a": "b", "c": {"d": 1}}


@pytest.mark.parametrize("name", ["a", f"{writing.TEMPORARY}a"])
def test_what_a_planted_link_leads_to_stays(tmp_path, name):
    precious = tmp_path / "precious"
    precious.write_text("precious")
    (tmp_path / name).symlink_to(precious)
    writing.write_text(tmp_path / "a", "new")
    assert (tmp_path / "a").read_text() == "new" and not (tmp_path / "a").is_symlink()
    assert precious.read_text() == "precious"


def test_nothing_is_appended_to_what_a_link_leads_to(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "log").symlink_to(tmp_path / "precious")
    with pytest.raises(OSError, match="log") as error:
        writing.append(tmp_path / "log", "row\n")
    assert error.value.errno == errno.ELOOP
    for row in ("a\n", "b\n"):
        writing.append(tmp_path / "new", row)
    assert (tmp_path / "new").read_text() == "a\nb\n"


def test_a_file_that_cannot_be_finished_leaves_the_old_one(tmp_path):
    path = tmp_path / "a"
    path.write_text("old")

    def write_half():
        with writing.new_file(path) as file:
            file.write(b"ne")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space left on device: '.*a'"):
        write_half()
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_what_there_is_no_room_for_is_known_before(tmp_path):
    writing.check_room(tmp_path, 10_000, 4_000)
    with pytest.raises(OSError, match=f"'{tmp_path}'") as error:
        writing.check_room(tmp_path, 2**61)
    assert error.value.errno in (errno.ENOSPC, errno.EFBIG)
    assert not list(tmp_path.iterdir())


def test_archives_come_back_and_changed_bits_are_noticed(tmp_path):
    path = tmp_path / "a.npz"
    arrays = {"x/y": np.arange(60.0).reshape(2, 30), "name": np.array("ant")}
    archives.write(path, arrays)
    after = archives.read(path)
    assert after.keys() == arrays.keys() and (after["x/y"] == arrays["x/y"]).all()

    whole = path.read_bytes()
    for bit in np.random.default_rng(0).integers(0, 8 * len(whole), 50):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bytes(damaged))
        with pytest.raises(base.UserError, match="is damaged"):
            archives.read(path)
    for kept in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:kept])
        with pytest.raises(base.UserError, match="is damaged"):
            archives.read(path)


def _npy(shape):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f4", "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (bytes(10_000), "has arrays of 10000 bytes, at most 1000"),
        (_npy((10**15,)), "can't be read"),
        (_npy((2,)), "can't be read"),
        (b"x", "can't be read"),
    ],
)
def test_an_archive_with_its_checksum_may_still_hold_too_much_or_nothing(
    tmp_path, content, message
):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("x.npy", content)
        file.comment = bytes(64)
    body = stream.getvalue()[:-64]
    (tmp_path / "a.npz").write_bytes(body + archives._checksum(body))
    with pytest.raises(base.UserError, match=message):
        archives.read(tmp_path / "a.npz", limit=1_000)
