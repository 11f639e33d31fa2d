"""Kills a trainer at random moments and goes on with it: `python -m experiments.kill_resume`.

One run goes through undisturbed. Each of the others gets SIGKILL at a moment drawn uniformly from
the time that the first one took, and is then resumed to its end. Its final parameters have to equal
those of the first run bit for bit, and so has its metrics.csv. Other code trains other parameters,
so leave the sources alone meanwhile.
"""

import csv
import pathlib
import random
import shlex
import shutil
import subprocess
import sys
import time
from typing import Annotated

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.config import limits
from eihrl_jax.runs import policies

SHORT = {
    "low": (
        "--robot point --num-envs 4 --capacity 4096 --warmup-iterations 64 --num-postures 64 "
        "--updates-per-iteration 4 --droq.hidden 32 32 --log-every 50 --evaluate-every 200 "
        "--checkpoint-every 200 --num-iterations 2000"
    ),
    "high": (
        "--learner.num-updates 4000 --learner.num-workers 16 --num-eval-episodes 16 "
        "--log-every 20 --evaluate-every 200 --checkpoint-every 200"
    ),
    "baseline": (
        "--method hiro --robot point --maze u --num-decisions 4 --num-envs 2 --period 5 "
        "--periods-per-round 2 --capacity 2000 --high-capacity 400 --manager.hidden 16 "
        "--controller.hidden 16 --num-eval-episodes 2 --log-rounds 5 --evaluate-every 20 "
        "--checkpoint-every 4 --num-steps 8000"
    ),
}
"""Options of a run that takes seconds and checkpoints all the time."""


@limits.dataclass
class KillConfig:
    """Kills a trainer at random moments, resumes it and compares with an undisturbed run.

    Attributes:
      trainer: which of the trainers.
      kills: how many runs are killed.
      options: options of the trainer, as on its command line; by default those of a short run.
      run: folder for all the runs; must not exist.
      seed: of the moments.
    """

    trainer: policies.Kind = "high"
    kills: Annotated[int, limits.Range(1, 10_000)] = 20
    options: str | None = None
    run: pathlib.Path = pathlib.Path("runs/kill_resume")
    seed: int = 0


def main(options: KillConfig) -> None:
    """Runs, kills, resumes and compares; ends with exit code 1 where anything differs."""
    if options.run.exists():
        raise base.UserError(f"{options.run} exists already: name another --run")

    start = time.monotonic()
    _finish(options, options.run / "whole")
    duration = time.monotonic() - start
    print(f"undisturbed run: {duration:.1f} s", flush=True)

    moments = random.Random(options.seed)
    differences = []
    for index in range(options.kills):
        folder = options.run / f"killed-{index:02d}"
        moment = moments.uniform(0.0, duration)
        # A run that ended before its moment is made again, with an earlier one.
        while not _kill(options, folder, moment):
            shutil.rmtree(folder)
            moment = moments.uniform(0.0, moment)
        state = _state(folder)
        _finish(options, folder)
        difference = _difference(options, folder)
        differences.append(difference)
        print(f"killed after {moment:5.1f} s ({state}): {difference or 'identical'}", flush=True)

    identical = differences.count(None)
    print(f"{identical} of {options.kills} killed runs equal the undisturbed one")
    sys.exit(identical != options.kills)


def _command(options: KillConfig, folder: pathlib.Path) -> list[str]:
    words = shlex.split(SHORT[options.trainer] if options.options is None else options.options)
    return [
        sys.executable,
        "-m",
        "eihrl_jax.cli",
        f"train-{options.trainer}",
        *words,
        "--run",
        str(folder),
        "--resume",
    ]


def _finish(options: KillConfig, folder: pathlib.Path) -> None:
    """Starts or resumes a run and waits for its end."""
    done = subprocess.run(_command(options, folder), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
        raise base.UserError(f"{folder} can't be finished: {reason[0].removeprefix('error: ')}")


def _kill(options: KillConfig, folder: pathlib.Path, moment: float) -> bool:
    """Starts a run and kills it after `moment` seconds; returns false where it ended before."""
    process = subprocess.Popen(
        _command(options, folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait() < 0


def _state(folder: pathlib.Path) -> str:
    """Says how far a killed run was."""
    saved = sorted(path.name for path in (folder / "checkpoints").glob("[0-9]*"))
    is_saving = any((folder / "checkpoints").glob(".*"))
    state = f"last checkpoint {int(saved[-1])}" if saved else "no checkpoint yet"
    return state + ", while saving" * is_saving


def _difference(options: KillConfig, folder: pathlib.Path) -> str | None:
    """Says what differs between a run and the undisturbed one, None where nothing does."""
    whole = options.run / "whole"
    expected, _ = policies.load(whole / policies.FOLDER, kind=options.trainer)
    found, _ = policies.load(folder / policies.FOLDER, kind=options.trainer)
    for (path, left), right in zip(
        jax.tree_util.tree_leaves_with_path(expected), jax.tree.leaves(found), strict=True
    ):
        if np.asarray(left).tobytes() != np.asarray(right).tobytes():
            return f"parameters differ at {jax.tree_util.keystr(path, simple=True)}"
    if _rows(folder) != _rows(whole):
        return "metrics.csv differs"
    return None


def _rows(folder: pathlib.Path) -> list[dict[str, str]]:
    """Rows of a run's metrics, which tell no times."""
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))
