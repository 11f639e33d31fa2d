"""The shell of the command lines: presets, help, one clear line for a mistake, exit codes."""

import dataclasses
import pathlib
from typing import Literal

import jax
import pytest

from eihrl_jax import base
from eihrl_jax.cli import shell
from eihrl_jax.cli.command import Command
from eihrl_jax.config import checks


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Trains something.

    Attributes:
      preset: named defaults.
      learning_rate: of Adam.
      engine: of the physics.
      run: folder of the run.
      resume: go on with it.
    """

    preset: str = "paper"
    learning_rate: float = 1e-3
    engine: Literal["mjx", "mujoco"] = "mjx"
    run: pathlib.Path = pathlib.Path("runs/x")
    resume: bool = False

    def __post_init__(self):
        checks.in_range("learning_rate", self.learning_rate, above=0.0)


PRESETS = {"paper": Options(), "best": Options(preset="best", learning_rate=0.25)}


@pytest.fixture(autouse=True)
def no_compilation_cache(monkeypatch):
    """Keeps the tests' JAX as it is."""
    monkeypatch.setattr(shell, "_set_compilation_cache", lambda: None)


def parsed(*arguments, presets=PRESETS):
    found = []
    shell.run(Command(found.append, Options, presets), arguments, "test")
    return found[0]


def test_numbers_have_32_bits_and_may_be_missing_whatever_the_environment_says():
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_debug_nans", True)
    try:
        parsed()
        assert not jax.config.jax_enable_x64 and not jax.config.jax_debug_nans
    finally:
        jax.config.update("jax_enable_x64", False)
        jax.config.update("jax_debug_nans", False)


@pytest.mark.parametrize(("named", "asked"), [(None, [(-8, 2)]), ("5", [])])
def test_threads_share_heaps_unless_the_user_says_how_many(named, asked, monkeypatch):
    calls = []

    class Library:
        def __init__(self, name):
            assert name is None  # this process itself

        def mallopt(self, *options):
            calls.append(options)

    monkeypatch.setattr(shell.ctypes, "CDLL", Library)
    monkeypatch.delenv("MALLOC_ARENA_MAX", raising=False)
    if named is not None:
        monkeypatch.setenv("MALLOC_ARENA_MAX", named)
    shell._share_heaps()
    assert calls == asked


def test_one_line_whatever_a_name_holds(capsys):
    def main(options):
        raise base.UserError("a\nb\x1b[2J\udcff is no maze")

    with pytest.raises(SystemExit):
        shell.run(Command(main, Options), [], "test")
    assert capsys.readouterr().err == "error: a\\nb\\x1b[2J\\udcff is no maze\n"


def failure(capsys, *arguments):
    """Exit code and lines on stderr of a command line that must fail."""
    with pytest.raises(SystemExit) as end:
        parsed(*arguments)
    output = capsys.readouterr()
    assert output.out == ""
    return end.value.code, output.err.splitlines()


def test_defaults_are_those_of_the_first_preset():
    assert parsed() == PRESETS["paper"]


@pytest.mark.parametrize("arguments", [("--preset", "best"), ("--preset=best",)])
def test_preset_sets_defaults_that_options_change(arguments):
    assert parsed(*arguments) == PRESETS["best"]
    changed = parsed("--resume", *arguments, "--learning-rate", "0.5")
    assert changed == Options(preset="best", learning_rate=0.5, resume=True)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--the-motor", "mj_c"),
        ("--the-motor=mj_c",),
        ("--the_motor", "mj_c"),
        ("--engine", "mj_c"),
        ("--the-motor=mujoco",),
    ],
)
def test_earlier_spellings_of_options_and_of_their_values_are_understood(arguments):
    earlier = {("", "--the-motor"): "--engine", ("--engine", "mj_c"): "mujoco"}
    found = []
    command = Command(found.append, Options, earlier=earlier)
    shell.run(command, [*arguments, "--run", "mj_c"], "test")
    # Only values of that option are other words now.
    assert found == [Options(engine="mujoco", run=pathlib.Path("mj_c"))]


@dataclasses.dataclass(frozen=True)
class Task:
    maze: str = "u"
    engine: str = "inner"


@dataclasses.dataclass(frozen=True)
class Nested:
    task: Task = Task()
    engine: str = "outer"
    seeds: tuple[int, ...] = ()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--maze", "s"), Nested(task=Task(maze="s"))),
        (("--mazes=s", "--seed", "1", "2"), Nested(task=Task(maze="s"), seeds=(1, 2))),
        (("--engine", "a", "--task.engine", "b"), Nested(task=Task(engine="b"), engine="a")),
    ],
)
def test_one_name_for_one_thing_in_all_commands(arguments, expected):
    found = []
    shell.run(Command(found.append, Nested), arguments, "test")
    assert found == [expected]


def test_help_shows_the_defaults_of_the_preset(capsys):
    with pytest.raises(SystemExit) as end:
        parsed("--help", "--preset", "best")
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert "default: 0.25" in text
    assert "of Adam" in text


def test_without_presets_the_defaults_are_those_of_the_class():
    assert parsed(presets={}) == Options()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--preset", "fast"), ["--preset", "fast", "paper, best"]),
        (("--preset",), ["--preset", "paper, best"]),
        (("--learning-rate", "-1"), ["learning_rate = -1.0", "greater than 0.0"]),
        (("--learning-rate", "x"), ["--learning-rate", "'x'"]),
        (("--learning-rate",), ["--learning-rate"]),
        (("--engine", "ode"), ["--engine", "'ode'", "mjx", "mujoco"]),
        (("--speed", "3"), ["--speed"]),
        (("--learning-rat", "3"), ["--learning-rat,", "did you mean --learning-rate?"]),
        (("extra",), ["extra"]),
    ],
)
def test_mistake_gets_one_line_and_exit_code_2(capsys, arguments, words):
    code, lines = failure(capsys, *arguments)
    assert code == 2
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert all(word in lines[0] for word in words), lines[0]


def test_users_mistake_found_later_gets_one_line(capsys):
    def main(_):
        raise base.UserError("maze has no start")

    with pytest.raises(SystemExit) as end:
        shell.run(Command(main, Options, PRESETS), [], "test")
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: maze has no start\n"


def test_a_place_that_cannot_be_written_to_gets_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()

    def main(_):
        (tmp_path / "file" / "run").mkdir(parents=True)

    with pytest.raises(SystemExit) as end:
        shell.run(Command(main, Options, PRESETS), [], "test")
    assert end.value.code == 2
    assert capsys.readouterr().err.splitlines() == [
        f"error: {tmp_path / 'file' / 'run'}: Not a directory"
    ]


def test_programming_error_keeps_its_traceback():
    def main(_):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        shell.run(Command(main, Options, PRESETS), [], "test")


def test_interrupt(capsys):
    def main(_):
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as end:
        shell.run(Command(main, Options, PRESETS), [], "test")
    assert end.value.code == 130
    assert capsys.readouterr().err == "interrupted\n"
