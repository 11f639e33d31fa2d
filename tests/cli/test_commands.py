"""The table of commands: the same ones under both names, listed without JAX, helped by hints."""

import os
import pathlib
import re
import subprocess
import sys

import pytest

import eihrl_jax
from eihrl_jax import mazes, robots
from eihrl_jax.cli import commands
from eihrl_jax.runs import policies

EXPERIMENTS = pathlib.Path(__file__).parents[2] / "experiments"
EARLIER_NAMES = {"compare_peers"}


def test_each_command_is_an_experiment_and_the_other_way_round():
    modules = {path.stem for path in EXPERIMENTS.glob("*.py")} - {"__init__"}
    assert modules - EARLIER_NAMES == set(commands.COMMANDS)
    for name in commands.COMMANDS:
        text = (EXPERIMENTS / f"{name}.py").read_text()
        assert f'commands.run("{name}")' in text
        assert len(text.splitlines()) <= 20


def test_help_lists_every_command_and_says_what_it_does(capsys):
    commands.main([])
    lines = capsys.readouterr().out.splitlines()
    for name, make in commands.COMMANDS.items():
        (line,) = [line for line in lines if line.split()[:1] == [name.replace("_", "-")]]
        assert make.__doc__ is not None
        assert line.endswith(make.__doc__.strip())
        assert len(line) <= 110


def test_choices_of_presets_stand_in_the_help_text(capsys):
    for name in ("train_high", "train_low", "train_baseline"):
        with pytest.raises(SystemExit):
            commands.main([name, "--help"])
        words = set(re.findall(r"[a-z]+", capsys.readouterr().out))
        assert set(commands.COMMANDS[name]().presets) <= words


def test_what_is_shipped_is_listed(capsys):
    commands.main(["list"])
    lines = capsys.readouterr().out.splitlines()
    firsts = {line.split()[0]: line for line in lines if line.split()}
    names = [*policies.shipped("low"), *robots.NAMES, *mazes.NAMES, *mazes.suites.NAMES]
    assert set(names) <= firsts.keys()
    assert "best-u-0 to 4" in firsts["best-u-0"] and "sparse reward" in firsts["best-u-0"]
    assert "perfect-19-0" in firsts["perfect-19"]
    commands.main(["list", "--what", "robots"])
    assert "best-u-0" not in capsys.readouterr().out


def test_version(capsys):
    commands.main(["--version"])
    assert capsys.readouterr().out == f"eihrl_jax {eihrl_jax.__version__}\n"


@pytest.mark.parametrize(
    ("word", "hint"), [("train_hihg", "did you mean train-high?"), ("xyz", "choose one of")]
)
def test_an_unknown_command_gets_one_line_with_a_hint(word, hint, capsys):
    with pytest.raises(SystemExit) as end:
        commands.main([word, "--run", "somewhere"])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {word!r} is not a command")
    assert hint in line


@pytest.mark.parametrize("spelling", ["train-high", "train_high"])
def test_help_of_a_command_names_it_as_it_was_called(spelling, capsys):
    with pytest.raises(SystemExit) as end:
        commands.main([spelling, "--help"])
    assert end.value.code == 0
    assert "usage: eihrl train-high" in capsys.readouterr().out


def test_a_list_of_commands_and_the_package_itself_load_no_jax():
    code = (
        "import sys, eihrl_jax\n"
        "from eihrl_jax.cli import commands\n"
        "commands.main([])\n"
        "heavy = {'jax', 'flax', 'mujoco', 'tyro', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize("code", ["main([])", "main(['train-high', '--help'])", "run('demo')"])
def test_who_stops_reading_ends_a_command_without_a_traceback(code):
    """As in `eihrl | head`."""
    imports = "import sys; from eihrl_jax.cli import commands; sys.argv = ['x', '--help']"
    reader, writer = os.pipe()
    os.close(reader)  # before the command begins: it may be the faster one
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}; commands.{code}"],
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode == 141


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no full device")
def test_results_are_written_though_the_output_cannot_be(tmp_path):
    words = ["maze", "u", "--save", str(tmp_path / "u.txt")]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "eihrl_jax.cli", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert (done.returncode, done.stderr) == (
        2,
        b"error: standard output: No space left on device\n",
    )
    assert (tmp_path / "u.txt").exists()


def test_letters_that_an_output_lacks_are_written_in_others():
    code = (
        "from eihrl_jax.cli import output\n"
        "output.outlives_its_reader(lambda: print('1 ± 2 … ε \\udcff'))()\n"
    )
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, env=environment
    )
    assert done.stdout == b"1 +- 2 ... \\u03b5 \\udcff\n"


def test_results_are_written_though_nobody_reads_the_output(tmp_path):
    words = ["maze", "u", "--save", str(tmp_path / "u.txt")]
    with subprocess.Popen(
        [sys.executable, "-m", "eihrl_jax.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141 and (tmp_path / "u.txt").exists()
