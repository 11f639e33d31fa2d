"""A run folder is never overwritten, and a killed run goes on as if nothing had happened."""

import dataclasses
import json
import math
import pathlib
import platform
import resource
import shutil

import jax.numpy as jnp
import pytest

from eihrl_jax import base
from eihrl_jax.runs import run_folder


@dataclasses.dataclass(frozen=True, kw_only=True)
class Network:
    widths: tuple[int, ...] = (256, 256)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    preset: str = "paper"
    learning_rate: float = 1e-3
    network: Network = Network()
    run: pathlib.Path = pathlib.Path("runs/x")
    resume: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class OtherConfig:
    preset: str = "best"
    num_landmarks: int = 20
    run: pathlib.Path = pathlib.Path("runs/x")
    resume: bool = False


RLIMIT = resource.RLIMIT_FSIZE  # beyond it the system says that a file is too large
STATE = {"x": jnp.zeros(3)}


def create(path, *, resume=False, **options):
    return run_folder.RunFolder.create(path, Config(**options), resume=resume)


def go_on(path, sources, **options):
    """Starts or resumes a run as far as its files."""
    config = Config(**options)
    with run_folder.RunFolder.create(path, config, resume=True, sources=sources) as run:
        run.restore(STATE)


def record(run, steps, save_at=()):
    for step in steps:
        run.log(step, {"success": step / 10, "loss": 1.0 / step})
        if step in save_at:
            run.save(step, {"x": jnp.full(3, float(step))})


def snapshot(path):
    return {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_new_run_records_config_and_versions(tmp_path, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", f"--xla_cpu_prefer_vector_width=256 --xla_dump_to={tmp_path}")
    with create(tmp_path / "deep" / "run", learning_rate=0.5) as run:
        assert run.restore(STATE) is None
    options = json.loads((run.path / "config.json").read_text())
    assert options["learning_rate"] == 0.5
    start = json.loads((run.path / "versions.json").read_text())[0]
    assert start["packages"]["jax"]
    assert start["device"] and start["cpu"]
    assert start["xla_flags"] == ["--xla_cpu_prefer_vector_width=256"]


def test_record_names_neither_host_nor_place(tmp_path):
    with create(tmp_path / "run") as run:
        record(run, [1])
    texts = [file.name + file.read_text(errors="ignore") for file in snapshot(run.path)]
    assert not [text for text in texts if platform.node() in text or str(tmp_path) in text]


def test_existing_run_is_refused_and_left_alone(tmp_path):
    with create(tmp_path / "run") as run:
        record(run, [1, 2], save_at=[2])
    before = snapshot(tmp_path)
    with pytest.raises(base.UserError, match=r"run exists already: .*--resume .*--run"):
        create(tmp_path / "run")
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("resume", [False, True])
def test_folder_of_something_else_is_refused_and_left_alone(tmp_path, resume):
    (tmp_path / "thesis.tex").write_text("precious")
    before = snapshot(tmp_path)
    with pytest.raises(base.UserError):
        create(tmp_path, resume=resume)
    assert snapshot(tmp_path) == before


def test_file_in_place_of_folder_is_refused(tmp_path):
    (tmp_path / "run").write_text("precious")
    with pytest.raises(base.UserError, match="is a file"):
        create(tmp_path / "run", resume=True)


def test_resume_of_absent_or_empty_folder_starts(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("absent", "empty"):
        with create(tmp_path / name, resume=True) as run:
            assert run.restore(STATE) is None


def test_resume_after_kill_before_config_was_complete(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".lock").touch()
    (tmp_path / "run" / ".incomplete-config.json").write_text("{")
    with create(tmp_path / "run") as run:
        assert run.restore(STATE) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"learning_rate": 0.5}, "learning_rate = 0.001 and can't go on with 0.5"),
        ({"network": Network(widths=(8,))}, r"network.widths = \[256, 256\] .* \[8\]"),
    ],
)
def test_resume_with_other_options_names_them(tmp_path, options, message):
    create(tmp_path / "run").close()
    with pytest.raises(base.UserError, match=message):
        create(tmp_path / "run", resume=True, **options)


def test_resume_of_another_kind_of_run_names_what_differs(tmp_path):
    create(tmp_path / "run").close()
    before = snapshot(tmp_path)
    with pytest.raises(base.UserError, match="with preset = 'paper' and can't go on with 'best'"):
        run_folder.RunFolder.create(tmp_path / "run", OtherConfig(), resume=True)
    assert snapshot(tmp_path) == before


def test_damaged_metrics_are_named_and_left_alone(tmp_path):
    with create(tmp_path / "run") as run:
        record(run, range(1, 4), save_at=(3,))
    file = tmp_path / "run" / "metrics.csv"
    damaged = file.read_text().replace("\n2,", "\n\n2,")
    file.write_text(damaged)
    with (
        create(tmp_path / "run", resume=True) as run,
        pytest.raises(base.UserError, match=r"metrics\.csv is damaged: a row doesn't begin"),
    ):
        run.restore(STATE)
    assert file.read_text() == damaged


def check_refused(tmp_path, message):
    """Checks that a resume is refused, and touches nothing."""
    before = snapshot(tmp_path)
    with (
        create(tmp_path / "run", resume=True) as run,
        pytest.raises(base.UserError, match=message),
    ):
        run.restore(STATE)
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("change", [("0.2", "0.3"), ("2,0.2,0.5,\n", ""), ("success", "loss")])
def test_metrics_that_were_changed_are_named_and_left_alone(tmp_path, change):
    with create(tmp_path / "run") as run:
        record(run, range(1, 4), save_at=(3,))
        run.log(4, {"later": 1.0})  # widens the table, which is no change
    create(tmp_path / "run", resume=True).close()
    file = tmp_path / "run" / "metrics.csv"
    whole = file.read_text()
    file.write_text(whole.replace(*change))
    check_refused(tmp_path, r"metrics.csv isn't what the run has logged .* step 3")
    file.write_text(whole)
    with create(tmp_path / "run", resume=True) as run:
        assert run.restore(STATE)[0] == 3


def test_a_run_without_checkpoint_says_that_it_begins_anew(tmp_path, capsys):
    with create(tmp_path / "run") as run:
        record(run, range(1, 3))
    with create(tmp_path / "run", resume=True) as run:
        assert run.restore(STATE) is None
    assert "has no checkpoint yet: the run begins anew" in capsys.readouterr().err


def test_a_refused_resume_touches_nothing(tmp_path):
    """Where checkpoints were removed the run would else lose its metrics, and begin anew."""
    with create(tmp_path / "run") as run:
        record(run, range(1, 4), save_at=(2,))
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    check_refused(tmp_path, r"checkpoints holds none, .* step 2; put it back")
    (tmp_path / "run" / "versions.json").write_text("3")
    check_refused(tmp_path, r"neither a checkpoint nor a readable versions\.json; put them back")


@pytest.mark.parametrize("name", [".incomplete-config.json", "metrics.csv", ".lock", "config.json"])
def test_what_a_planted_link_leads_to_stays(tmp_path, name):
    with create(tmp_path / "run") as run:
        record(run, range(1, 4), save_at=(2,))
    link, precious = tmp_path / "run" / name, tmp_path / "precious"
    precious.write_bytes(link.read_bytes() if link.exists() else b"precious")
    before = precious.read_bytes()
    link.unlink(missing_ok=True)
    link.symlink_to(precious)
    try:
        with create(tmp_path / "run", resume=True) as run:
            run.restore(STATE)
            record(run, (3,), save_at=(3,))
    except OSError as error:
        assert error.filename and name == ".lock"
    assert precious.read_bytes() == before


MAZE = {"preset": {"maze.txt": b"###\n#S#\n"}, "learning_rate": {}}


@pytest.mark.parametrize(
    ("files", "difference"),
    [
        ({"maze.txt": b"###\n#.#\n"}, "maze.txt differs in line 2"),
        ({"maze.txt": b"###\n"}, "maze.txt differs in line 2"),
        ({"maze.txt": b"\xff"}, "maze.txt differs"),
        ({"b.txt": b""}, "maze.txt is missing"),
        (MAZE["preset"] | {"b.txt": b""}, "b.txt is new"),
    ],
)
def test_contents_that_changed_are_named_and_nothing_is_touched(tmp_path, files, difference):
    go_on(tmp_path / "run", MAZE)
    before = snapshot(tmp_path)
    with pytest.raises(base.UserError, match=rf"^preset is not .* with: {difference}; .* kept in"):
        go_on(tmp_path / "run", {"preset": files})
    assert snapshot(tmp_path) == before


def test_the_same_contents_by_another_name_are_the_same(tmp_path):
    go_on(tmp_path / "run", MAZE)
    go_on(tmp_path / "run", MAZE, preset="another path")
    assert (tmp_path / "run/sources/preset/maze.txt").read_bytes() == MAZE["preset"]["maze.txt"]
    # Of a run that kept none, names are all that there is to compare; and so where none is named.
    for kept, named in (({}, MAZE), (MAZE, {"preset": {}})):
        shutil.rmtree(tmp_path / "run")
        go_on(tmp_path / "run", kept)
        with pytest.raises(base.UserError, match="with preset = 'paper'"):
            go_on(tmp_path / "run", named, preset="another path")


@pytest.mark.parametrize("name", [".incomplete-sources", "sources"])
def test_sources_are_written_through_no_link(tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    go_on(tmp_path / "run", {})
    (tmp_path / "run" / name).symlink_to(tmp_path / "elsewhere")
    go_on(tmp_path / "run", MAZE)
    assert not any((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize("limit", [30, 300, 3_000])
def test_a_full_disk_is_told_with_the_file_and_costs_what_was_being_written(tmp_path, limit):
    state = {"x": jnp.zeros(1_000)}
    with create(tmp_path / "run") as run:
        run.log(1, {"loss": 1.0})
        run.save(1, state)
    with create(tmp_path / "run", resume=True) as run:
        run.restore(state)
        before, limits = snapshot(run.path / "checkpoints"), resource.getrlimit(RLIMIT)
        resource.setrlimit(RLIMIT, (limit, limits[1]))
        try:
            with pytest.raises(OSError, match="large") as error:
                run.log(2, {"loss": 2.0})
                run.save(2, state)
        finally:
            resource.setrlimit(RLIMIT, limits)
    assert str(run.path) in error.value.filename
    assert snapshot(run.path / "checkpoints") == before
    with create(tmp_path / "run", resume=True) as run:
        assert run.restore(state)[0] == 1
        assert (run.path / "metrics.csv").read_text() == "step,loss\n1,1.0\n"


def test_config_is_that_of_the_last_start(tmp_path):
    options = Config()
    for resume, learning_rate in ((False, options.learning_rate), (True, 0.5)):
        with run_folder.RunFolder.create(
            tmp_path / "run",
            Config(learning_rate=learning_rate),
            resume=resume,
            may_change={"learning_rate"},
        ) as run:
            run.restore(STATE)
    assert json.loads((tmp_path / "run" / "config.json").read_text())["learning_rate"] == 0.5


def test_second_process_is_kept_out(tmp_path):
    with create(tmp_path / "run"):
        with pytest.raises(base.UserError, match="being written to by another process"):
            create(tmp_path / "run", resume=True)
    create(tmp_path / "run", resume=True).close()


@pytest.mark.parametrize("save_at", [[], [4], [4, 6]])
def test_metrics_after_a_kill_equal_those_of_the_uninterrupted_run(tmp_path, save_at):
    with create(tmp_path / "whole") as whole:
        record(whole, range(1, 11))
    with create(tmp_path / "run") as killed:
        record(killed, range(1, 9), save_at)
    with (killed.path / "metrics.csv").open("a") as file:
        file.write("9,0.")  # what a kill in the middle of a line leaves
    with create(tmp_path / "run", resume=True) as run:
        restored = run.restore(STATE)
        step = restored[0] if restored else 0
        assert step == max(save_at, default=0)
        record(run, range(step + 1, 11))
    expected = (tmp_path / "whole" / "metrics.csv").read_text()
    assert (run.path / "metrics.csv").read_text() == expected
    assert len(json.loads((run.path / "versions.json").read_text())) == 2


def test_row_is_on_disk_at_once(tmp_path):
    with create(tmp_path / "run") as run:
        record(run, [1])
        assert (run.path / "metrics.csv").read_text() == "step,success,loss\n1,0.1,1.0\n"


def test_new_metrics_add_columns(tmp_path):
    with create(tmp_path / "run") as run:
        record(run, [1])
        run.log(2, {"loss": jnp.float32(0.5)})
        run.log(3, {"loss": 0.25, "fun": 1.0})
        run.log(4, {"loss": math.nan, "never": math.nan})
    lines = (run.path / "metrics.csv").read_text().splitlines()
    assert lines.pop() == "4,,,"  # what has no value is absent
    assert lines == ["step,success,loss,fun", "1,0.1,1.0,", "2,,0.5,", "3,,0.25,1.0"]


def test_metrics_that_came_later_are_kept_apart_by_resume(tmp_path):
    def measure(run, steps):
        for step in steps:
            run.log(step, {"loss": 1.0} | ({"eval": 2.0} if step % 3 == 0 else {}))

    with create(tmp_path / "whole") as whole:
        measure(whole, range(1, 7))
    with create(tmp_path / "run") as run:
        measure(run, [1, 2])
        run.save(2, STATE)
        measure(run, [3, 4])
    with create(tmp_path / "run", resume=True) as run:
        assert run.restore(STATE)[0] == 2
        measure(run, range(3, 7))
    assert (run.path / "metrics.csv").read_text() == (whole.path / "metrics.csv").read_text()


def test_damaged_config_is_named(tmp_path):
    create(tmp_path / "run").close()
    (tmp_path / "run" / "config.json").write_text("{")
    with pytest.raises(base.UserError, match=r"config.json is no JSON"):
        create(tmp_path / "run", resume=True)


@pytest.mark.parametrize("of", ["the run", "its network"])
def test_option_that_is_newer_than_the_run_counts_as_left_alone(of, tmp_path):
    """A run of an earlier version goes on; but not with another value of the new option."""
    create(tmp_path / "run").close()
    file = tmp_path / "run" / "config.json"
    options = json.loads(file.read_text())
    if of == "the run":
        del options["network"]
    else:
        del options["network"]["widths"]
    file.write_text(json.dumps(options))
    create(tmp_path / "run", resume=True).close()
    with pytest.raises(base.UserError, match=r"network.widths = \[256, 256\]"):
        create(tmp_path / "run", resume=True, network=Network(widths=(8,)))
