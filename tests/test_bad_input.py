"""What a user can get wrong on the command lines: one clear line, exit code 2, nothing touched."""

import os
import pathlib
import runpy
import sys

import pytest

from eihrl_jax.cli import shell
from eihrl_jax.runs import policies
from eihrl_jax.training import parallel

RUN = "{tmp}/new"

MISTAKES = [
    # trainer and options; what the line must name
    ("train_low --robot walrus", ["walrus", "point, ant, swimmer, humanoid, go1"]),
    ("train_low --num-envs 0", ["num_envs = 0", "at least 1"]),
    ("train_low --droq.gamma 1.5", ["gamma = 1.5", "at most 1.0"]),
    ("train_low --engine ode", ["--engine", "ode", "mujoco", "mjx"]),
    ("train_low --preset fastest", ["--preset", "fastest", "paper"]),
    ("train_low --speed 3", ["--speed"]),
    ("train_baseline --method dqn", ["--method 'dqn'", "droq, higl, hrac, hiro, hess"]),
    ("train_baseline --method higl --manager.reach 0", ["reach = 0", "greater than 0"]),
    (
        "train_baseline --method hrac --period 2 --periods-per-round 4",
        ["adjacency.steps = 9", "at most 7"],
    ),
    (
        "train_baseline --method hiro --guidance landmarks",
        ["guidance = 'landmarks'", "'none'", "method = 'hiro'"],
    ),
    ("train_baseline --maze nowhere.txt", ["nowhere.txt"]),
    ("train_baseline --run {tmp}/old", ["{tmp}/old", "--resume", "--run"]),
    ("train_baseline --method hess --num-decisions 2", ["period = 50", "the 50 control steps"]),
    ("train_baseline --method hess --capacity 7", ["num_envs = 10", "capacity = 7"]),
    ("train_low --run {tmp}/old", ["{tmp}/old", "--resume", "--run"]),
    ("train_low --run {tmp}/old/config.json", ["{tmp}/old/config.json"]),
    ("train_high --task.maze g9", ["g9", "random", "spiral", "g3"]),
    ("train_high --task.robot walrus", ["walrus", "ant"]),
    ("train_high --task.maze {tmp}/closed.txt", ["closed.txt"]),
    ("train_high --task.maze {tmp}/ragged.txt", ["ragged.txt", "row"]),
    ("train_high --task.maze {tmp}/unknown.txt", ["unknown.txt", "'x'", "row", "column"]),
    ("train_high --task.maze {tmp}/skips.txt", ["skips.txt", "2"]),
    ("train_high --task.maze {tmp}/startless.txt", ["startless.txt", "start"]),
    ("train_high --task.maze {tmp}/absent.txt", ["absent.txt"]),
    ("train_high --task.sigma -1", ["sigma = -1.0", "at least 0.0"]),
    ("train_high --learner.num-updates 0", ["num_updates = 0", "at least 1"]),
    ("train_high --learner.num-updates x", ["--learner.num-updates", "'x'"]),
    ("train_high --run {tmp}/old", ["{tmp}/old", "--resume", "--run"]),
    ("train_high --run {tmp}/old --resume", ["{tmp}/old", "preset"]),
    ("evaluate --mazes random g9", ["g9", "spiral"]),
    ("evaluate --mazes {tmp}/closed.txt", ["closed.txt"]),
    ("evaluate --high random --robot walrus", ["walrus", "ant"]),
    ("evaluate --mazes u --reading.start 2 2", ["'u'", "start and goal of its own"]),
    ("evaluate --mazes {tmp}/startless.txt --reading.start 1 1", ["start = 1 1", "wall"]),
    ("evaluate --episodes 0", ["episodes = 0", "at least 1"]),
    ("evaluate --movement fly", ["--movement", "fly"]),
    ("evaluate --high {tmp}/absent", ["{tmp}/absent", "policy"]),
    ("evaluate --high {tmp}/truncated", ["{tmp}/truncated", "damaged"]),
    ("evaluate --high {tmp}/walker", ["{tmp}/walker", "low-level", "high-level"]),
    ("evaluate --high random --low {tmp}/walker", ["{tmp}/walker", "'point'", "'ant'"]),
    ("evaluate --high random --out {tmp}/old", ["{tmp}/old"]),
    ("maze {tmp}/absent.txt --save {tmp}/new", ["absent.txt", "neither a file"]),
    ("maze u --save {tmp}/old/config.json", ["{tmp}/old/config.json", "exists"]),
    ("maze u --scenario -1", ["scenario = -1", "at least 0"]),
    ("maze u --occupied 2", ["occupied = 2.0", "at most 1.0"]),
    ("compare_baselines --methods dqn", ["methods = 'dqn'", "rand_h", "hess"]),
    (
        "compare_baselines --methods hess --mazes spiral --num-steps 9000",
        ["num_steps = 9000", "hess"],
    ),
    (
        "compare_baselines --methods ours --out {tmp}/baselines",
        ["baselines/ours-random-0", "config.json"],
    ),
    ("small_maze --methods droq", ["methods = 'droq'", "hiro, hrac, higl, hess"]),
    ("small_maze --out {tmp}/closed.txt", ["{tmp}/closed.txt"]),
    ("report --parts baselines", ["--baselines"]),
    ("report --policies {tmp}/absent", ["policies = {tmp}/absent", "no folder"]),
    ("report --out {tmp}/page", ["{tmp}/page/report.html", "not overwritten"]),
    ("report --parts baselines --baselines {tmp}/old", ["{tmp}/old", "<method>-<maze>-<seed>"]),
    # Earlier spellings.
    ("compare_peers --methods dqn", ["methods = 'dqn'", "rand_h", "hess"]),
    ("report --parts peers --peers {tmp}/old", ["baselines = {tmp}/old"]),
    ("value_gap --walking-episodes 1", ["full_episodes = 1", "at least 2"]),
    ("reproduce_higl --method hess", ["--method", "hess"]),
    ("reproduce_higl --run {tmp}/old", ["{tmp}/old", "--resume", "--run"]),
]

NOWHERE = ("{tmp}/LONG/x", "{tmp}/loop/x", "/proc/x/y", "{tmp}/pipe")
"""Places at which no file or folder can be."""

PLACED = (
    "train_low --run PLACE",
    "train_high --run PLACE",
    "train_high --task.maze PLACE",
    "train_baseline --run PLACE",
    "evaluate --mazes PLACE",
    "evaluate --high PLACE",
    "evaluate --high random --low PLACE",
    "evaluate --high random --robot PLACE.toml",
    "evaluate --high random --out PLACE",
    "measure_low --out PLACE",
    "maze PLACE",
    "maze u --save PLACE",
    "plot PLACE",
    "compare PLACE PLACE",
    "report --policies PLACE",
    "report --out PLACE",
    "robot PLACE",
)

MISTAKES += [
    (line.replace("PLACE", NOWHERE[i % len(NOWHERE)]), []) for i, line in enumerate(PLACED)
]

TRAINERS = ("train_low", "train_high", "train_baseline", "reproduce_higl")
"""What names its folder by --run instead of --out."""

MAZES = {
    "closed": "#####\n#S#1#\n#####\n",
    "ragged": "#####\n#S1#\n#####\n",
    "unknown": "#####\n#Sx1#\n#####\n",
    "skips": "######\n#S1.3#\n######\n",
    "startless": "#####\n#..1#\n#####\n",
}


@pytest.fixture
def place(tmp_path):
    """A folder with broken mazes, an old run, a truncated policy and one of another robot."""
    for name, text in MAZES.items():
        (tmp_path / f"{name}.txt").write_text(text)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "config.json").write_text("{}")
    run = tmp_path / "baselines" / "ours-random-0" / "policy"
    policies.save(run, kind="high", params={}, meta={})
    policies.save(tmp_path / "walker", kind="low", params={}, meta={"robot": "point"})
    policies.save(tmp_path / "truncated", kind="high", params={}, meta={})
    meta = tmp_path / "truncated" / "meta.json"
    meta.write_bytes(meta.read_bytes()[:-3])
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "report.html").write_text("<!doctype html>\n<title>precious</title>\n")
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


def snapshot(folder: pathlib.Path) -> dict[pathlib.Path, bytes]:
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize(("line", "words"), MISTAKES, ids=[line for line, _ in MISTAKES])
def test_mistake_is_told_in_one_line(line, words, place, monkeypatch, capsys):
    module, *arguments = line.replace("LONG", "x" * 300).format(tmp=place).split()
    where = "--run" if module in TRAINERS else "--save" if module == "maze" else "--out"
    if where not in arguments:
        arguments += [where, RUN.format(tmp=place)]
    before = snapshot(place)
    monkeypatch.setattr(shell, "_set_compilation_cache", lambda: None)
    monkeypatch.setattr(parallel, "use_cpu_cores", lambda: None)
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    monkeypatch.delitem(sys.modules, f"experiments.{module}", raising=False)
    with pytest.raises(SystemExit) as end:
        runpy.run_module(f"experiments.{module}", run_name="__main__")
    assert end.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert [word for word in words if word.format(tmp=place) not in lines[0]] == [], lines[0]
    after = snapshot(place)
    assert {file: after.get(file) for file in before} == before


@pytest.mark.parametrize(
    "module",
    [
        *(
            "train_low",
            "train_high",
            "train_baseline",
            "compare_baselines",
            "evaluate",
            "benchmark",
        ),
        *("faults", "train_policies", "ablate_high", "ablate_low", "small_maze", "report"),
    ],
)
def test_help_names_options_and_defaults(module, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [module, "--help"])
    monkeypatch.delitem(sys.modules, f"experiments.{module}", raising=False)
    with pytest.raises(SystemExit) as end:
        runpy.run_module(f"experiments.{module}", run_name="__main__")
    assert end.value.code == 0
    assert "default:" in capsys.readouterr().out
