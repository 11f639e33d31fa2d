"""The fault run sees what it is there to see; what it disturbs is a stand-in of a few lines."""

import functools
import random

import pytest

from eihrl_jax.studies import faults, short_jobs

STAND_IN = """
import os, pathlib, sys, time
folder = pathlib.Path(sys.argv[1])
for i in range(10):
    file = folder / "a" / f"{i:02d}"
    told = None
    try:
        time.sleep(0.01)
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.is_file() and file.read_text() != f"whole {i}":
            told = "is damaged"
        file.with_name(".new").write_text(f"whole {i}")
        if told is None:
            file.with_name(".new").rename(file)
    except OSError as error:
        told = error.strerror
    except KeyboardInterrupt:
        sys.exit(130)
    if told and HONEST:
        sys.stderr.write(f"error: {file}: {told}")
        sys.exit(2)
    (folder / "eval.json").write_text("begun")
(folder / "tables.md").write_text("1" if HONEST else str(os.getpid()))
"""


@pytest.fixture
def job(tmp_path):
    """Makes a job that takes a tenth of a second, and runs it undisturbed."""

    def make(is_honest):
        main = functools.partial(exec, STAND_IN.replace("HONEST", str(is_honest)), {})
        made = short_jobs.Job("report", main, [], tmp_path, random.Random(0), 0.15)
        assert made.run(made.whole) == (0, [])
        made.make_half()
        return made

    return make


def test_who_loses_nothing_passes(job, tmp_path):
    made = job(True)
    told = {kind: faults.disturbed(made, kind, tmp_path / kind) for kind in faults.FAULTS}
    assert told == dict.fromkeys(faults.FAULTS)


@pytest.mark.parametrize("kind", ["SIGKILL", "two files swapped"])
def test_who_loses_something_is_found_out(job, kind, tmp_path):
    made = job(False)
    assert faults.disturbed(made, kind, tmp_path / "0") == "tables.md differ"


@pytest.mark.parametrize(
    ("code", "said", "mistake"),
    [
        (0, ["100 %"], None),
        (2, ["100 %", "error: no room"], None),
        (-9, [], None),
        (2, [], "0 lines of error: []"),
        (2, ["error: a", "error: b"], "2 lines of error: ['error: a', 'error: b']"),
        (1, ["Traceback (most recent call last):", "E"], "traceback: E"),
        (-11, ["."], "exit code -11: ['.']"),
        (None, ["5 %"], "hung: ['5 %']"),
    ],
)
def test_ends_are_judged(code, said, mistake):
    assert short_jobs.Ended(code, said).mistake() == mistake


@pytest.mark.parametrize("change", [faults._flipped, faults._cut, faults._removed])
def test_files_are_changed(change, tmp_path):
    file = tmp_path / "file"
    for data in (b"", b"some text"):
        file.write_bytes(data)
        assert change([file], random.Random(0)) != {file: data} or not data
