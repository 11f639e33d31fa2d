"""The training loop: when it does what, and that a kill at any moment changes nothing."""

import csv
import dataclasses
import json
import os
import pathlib
import shutil
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from eihrl_jax import base
from eihrl_jax.runs import checkpoint, policies, run_folder
from eihrl_jax.training import loop


class Killed(BaseException):
    """Stands for the end of the process."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    run: pathlib.Path
    resume: bool = False
    length: int = 12
    seed: int = 0


class State(struct.PyTreeNode):
    value: jax.Array
    key: jax.Array


@dataclasses.dataclass
class Job:
    """Adds up random numbers, two steps at a time, and notes what it is asked for."""

    length: int = 12
    kill_at: tuple[str, int] = ("never", 0)
    stop_at: tuple[str, int] = ("never", 0)
    calls: list = dataclasses.field(default_factory=list)
    done: int = 0
    num_compiled: int = 0
    sources: dict = dataclasses.field(default_factory=dict)

    @property
    def plan(self):
        return loop.Plan(
            kind="high",
            title="sum",
            num_steps=self.length,
            log_every=2,
            evaluate_every=6,
            checkpoint_every=4,
            length_option="length",
            may_change=("length",),
            shown={"value": "value", "eval/square": "square", "rare": "rare"},
            units_per_step=10,
        )

    def note(self, call, done):
        self.calls.append((call, done))
        if self.kill_at == (call, done):
            raise Killed
        if self.stop_at == (call, done):
            os.kill(os.getpid(), signal.SIGINT)

    def init(self):
        return State(value=jnp.float32(0.0), key=jax.random.key(3))

    def compile_training(self, state):
        self.num_compiled += 1

        def advance(state):
            self.done = int(state.value // 10) + 2
            self.note("advance", self.done)
            key, now_key = jax.random.split(state.key)
            drawn = jax.random.uniform(now_key)
            # Tens count the steps.
            value = 10.0 * self.done + drawn
            return State(value=value, key=key), {"value": value}

        return advance

    def compile_evaluation(self, state):
        def evaluate(state, done):
            self.note("evaluate", done)
            return {"eval/square": float(state.value) ** 2}

        return evaluate

    def begin(self, state, progress):
        self.note("begin", 0)
        return state.replace(value=state.value + 0.5)

    def row(self, state, metrics):
        self.note("row", self.done)
        rare = float(self.done) if self.done == 8 else np.nan
        return {"value": float(metrics["value"]), "rare": rare}

    def policy(self, state):
        return {"value": state.value}, {"steps": int(state.value // 10)}

    def finish(self, path, state):
        self.note("finish", self.done)
        (path / "extra").write_text("left by the job")
        return {"ended": True}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Returns an undisturbed run, and what its job was asked for."""
    run = tmp_path_factory.mktemp("loop") / "whole"
    job = Job()
    assert loop.run(job, Options(run=run)) > 0.0
    return run, job.calls


def test_a_run_says_what_comes_and_how_long_it_takes(tmp_path, capsys):
    loop.run(Job(), Options(run=tmp_path / "told"))
    lines = capsys.readouterr().out.splitlines()
    first = lines.index(next(line for line in lines if "Ctrl-C" in line))
    assert first == 0 and "told" in lines[0]
    assert any(line.endswith("to go, evaluations left out") for line in lines)


def test_everything_is_done_when_it_is_due(whole):
    run, calls = whole
    steps = (2, 4, 6, 8, 10, 12)
    expected = [("begin", 0)]
    for step in steps:
        expected += [("advance", step), ("row", step)]
        expected += [("evaluate", step)] if step in (6, 12) else []
    assert calls == [*expected, ("finish", 12)]
    with (run / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == list(steps)
    assert [bool(row["eval/square"]) for row in rows] == [step in (6, 12) for step in steps]
    assert sorted(int(path.name) for path in (run / "checkpoints").iterdir()) == [8, 12]
    params, meta = policies.load(run / policies.FOLDER, kind="high")
    assert int(params["value"] // 10) == 12
    assert meta["steps"] == 12 and meta["ended"] and meta["versions"]["packages"]["jax"]
    assert (run / "extra").is_file()
    assert not (run / policies.LATEST).exists()


@pytest.mark.parametrize(
    "moment",
    [
        ("begin", 0),
        ("advance", 2),
        ("row", 4),
        ("evaluate", 6),
        ("advance", 10),
        ("evaluate", 12),
        ("finish", 12),
    ],
    ids=lambda moment: f"{moment[0]}-{moment[1]}",
)
def test_a_kill_changes_nothing(whole, tmp_path, moment):
    run = tmp_path / "run"
    with pytest.raises(Killed):
        loop.run(Job(kill_at=moment), Options(run=run))
    assert not (run / policies.FOLDER).exists()
    job = Job()
    loop.run(job, Options(run=run, resume=True))
    assert_same(run, whole[0])
    # Checkpoints are of the steps 4, 8 and 12.
    call, step = moment
    saved = step if call == "finish" else max(step - 1, 0) // 4 * 4
    advanced = [done for call, done in job.calls if call == "advance"]
    assert advanced == list(range(saved + 2, 14, 2))
    assert (("begin", 0) in job.calls) == (saved == 0)
    assert job.num_compiled == (call != "finish")  # nothing where only the policy is missing


@pytest.mark.parametrize(
    ("moment", "kept"),
    [
        (("begin", 0), "nothing yet"),
        (("advance", 6), "60 of 120 steps (50 %)"),
        (("evaluate", 6), "60 of 120 steps (50 %)"),
        (("finish", 12), "120 of 120 steps (100 %)"),
    ],
)
def test_ctrl_c_loses_nothing(whole, tmp_path, capsys, moment, kept):
    run = tmp_path / "run"
    with pytest.raises(base.Stopped) as stop:
        loop.run(Job(stop_at=moment), Options(run=run))
    assert str(stop.value) == f"{run} keeps {kept}"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    # What it has learned so far can be used.
    if moment[1]:
        _, meta = policies.load(policies.find(run, "high"), kind="high")
        assert meta["steps"] == moment[1]
        assert f"{run} isn't finished: its last checkpoint is taken" in capsys.readouterr().err
    loop.run(Job(), Options(run=run, resume=True))
    assert_same(run, whole[0])
    assert (f"{run} goes on from {kept}" in capsys.readouterr().out) == bool(moment[1])
    steps = [start.get("step") for start in run_folder.read_starts(run)]
    assert steps == [moment[1] or None, 12 if moment[1] < 12 else None]


def test_the_clock_saves_where_the_options_do_not(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "SECONDS_BETWEEN_SAVES", 0.0)
    monkeypatch.setattr(loop, "_SAVING_SHARE", 1e9)
    watched = []
    run = tmp_path / "run"
    loop.run(
        Job(),
        Options(run=run),
        lambda path: watched.append(checkpoint.last_step(path / "checkpoints")),
    )
    assert watched == [2, 4, 6, 8, 10, 12]
    assert_same(run, whole[0])


def test_a_longer_run_goes_on_from_the_end_of_the_shorter(whole, tmp_path):
    run = tmp_path / "run"
    # Its last row goes beyond its end.
    loop.run(Job(length=5), Options(run=run, length=5))
    assert (run / "metrics.csv").read_text().splitlines()[-1].startswith("6,")
    loop.run(Job(length=5), Options(run=run, length=5, resume=True))
    loop.run(Job(), Options(run=run, resume=True))
    assert_same(run, whole[0])


def test_a_run_is_not_made_shorter_than_it_is(whole, tmp_path):
    run = shutil.copytree(whole[0], tmp_path / "run")
    before = (run / "config.json").read_text()
    with pytest.raises(base.UserError, match=r"length = 10 is less than .*run has trained: 12"):
        loop.run(Job(length=10), Options(run=run, length=10, resume=True))
    assert (run / "config.json").read_text() == before


def test_other_options_may_not_change(whole, tmp_path):
    run = shutil.copytree(whole[0], tmp_path / "run")
    with pytest.raises(base.UserError, match="seed = 0 and can't go on with 1"):
        loop.run(Job(), Options(run=run, seed=1, resume=True))


def test_a_state_of_another_version_is_refused_in_one_line(tmp_path):
    """As one of before `memory` was called `replay`."""

    class Old(struct.PyTreeNode):
        memory: jax.Array
        key: jax.Array

    run = tmp_path / "run"
    old = Old(memory=jnp.float32(0.0), key=jax.random.key(3))
    with run_folder.RunFolder.create(run, Options(run=run)) as folder:
        for step in (2, 4):
            folder.log(step, {"value": 1.0})
            folder.save(step, old)
    before = (run / "metrics.csv").read_text()
    with pytest.raises(base.UserError) as error:
        loop.run(Job(), Options(run=run, resume=True))
    assert str(error.value) == (
        f"{run / 'checkpoints' / f'{4:012d}'} holds another network or state: value is nothing, "
        "expected float32[]; it comes from other options or from another version of eihrl_jax"
    )
    assert (run / "metrics.csv").read_text() == before


def test_what_has_no_number_is_shown_as_it_was(tmp_path, monkeypatch):
    shown = []
    update = loop.progress_lib.Progress.update

    def note(self, done, metrics=None):
        shown.append((done, set(metrics)))
        update(self, done, metrics)

    monkeypatch.setattr(loop.progress_lib.Progress, "update", note)
    loop.run(Job(), Options(run=tmp_path / "run"))
    by_step = dict(shown)
    assert list(by_step) == [20, 40, 60, 80, 100, 120]
    assert by_step[20] == {"value"} and by_step[60] == {"value", "square"}
    assert by_step[80] == {"value", "rare"}


def assert_same(run, whole):
    assert (run / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()
    (params, meta), (expected, expected_meta) = (
        policies.load(path / policies.FOLDER, kind="high") for path in (run, whole)
    )
    np.testing.assert_array_equal(params["value"], expected["value"])
    meta.pop("versions"), expected_meta.pop("versions")
    assert json.dumps(meta) == json.dumps(expected_meta)
