"""The jobs that `faults` disturbs: commands that take seconds, and how they end.

Each runs in a process of its own, forked off a server that has imported everything beforehand.
"""

import contextlib
import csv
import ctypes
import dataclasses
import multiprocessing
import os
import pathlib
import random
import resource
import shlex
import signal
import sys
import time
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from typing import Literal, NamedTuple, get_args

import jax
import numpy as np

from eihrl_jax import base
from eihrl_jax.evaluation import results
from eihrl_jax.runs import policies
from eihrl_jax.storage import reading, writing

Name = Literal["high", "low", "baseline", "evaluate", "report", "dataset"]

_TRAINERS: tuple[policies.Kind, ...] = get_args(policies.Kind)

_WORDS: dict[Name, str] = {
    "high": (
        "train-high --task.robot point --task.maze u --learner.num-updates 60 "
        "--learner.num-workers 8 --learner.window 4 --num-eval-episodes 8 --log-every 3 "
        "--evaluate-every 30 --checkpoint-every 15 --resume --run"
    ),
    "low": (
        "train-low --robot point --num-envs 4 --capacity 512 --warmup-iterations 16 "
        "--num-postures 16 --updates-per-iteration 2 --droq.hidden 16 16 --log-every 10 "
        "--evaluate-every 50 --checkpoint-every 50 --num-iterations 200 --resume --run"
    ),
    "baseline": (
        "train-baseline --method hiro --robot point --maze u --num-decisions 4 --num-envs 2 "
        "--period 5 --periods-per-round 2 --capacity 2000 --high-capacity 400 --manager.hidden 16 "
        "--controller.hidden 16 --num-eval-episodes 2 --log-rounds 5 --evaluate-every 10 "
        "--checkpoint-every 5 --num-steps 2000 --resume --run"
    ),
    "evaluate": (
        "evaluate --mazes u --robot point --high uniform frontier shortest --movement oracle "
        "--episodes 20 --animate none --out"
    ),
    "report": (
        "report --parts own --high uniform frontier --mazes u --movement oracle --episodes 20 --out"
    ),
    "dataset": (
        "dataset --maze u --robot point --high uniform --movement oracle --episodes 40 --batch 4 "
        "--resume --out"
    ),
}
"""Command lines without the folder at their ends."""

_KEPT: dict[Name, str] = {
    **dict.fromkeys(_TRAINERS, "checkpoints/[0-9]*"),
    "evaluate": "eval.json",
    "report": "**/eval.json",
    "dataset": "**/*.npz",
}
"""What there is in a folder as soon as there is something to lose."""

_PRELOADED = (
    *("eihrl_jax.studies.short_jobs", "eihrl_jax.cli.shell", "eihrl_jax.gym"),
    *("eihrl_jax.reporting.trainers", "eihrl_jax.reporting.evaluations"),
    "eihrl_jax.reporting.report",
)

_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload(list(_PRELOADED))


class Limits(NamedTuple):
    """What a process has to do with.

    Attributes:
      bytes: that a file may have at most; None: as many as the disk has room for.
      is_bound: it keeps to permissions of folders, even if its parent, as root, doesn't have to.
    """

    bytes: int | None = None
    is_bound: bool = False


_NONE = Limits()


class Ended(NamedTuple):
    """How a process has ended.

    Attributes:
      code: its exit code, a signal's number with a minus; None where it had to be killed.
      said: its lines on standard error.
    """

    code: int | None
    said: list[str]

    def mistake(self) -> str | None:
        """Says what is wrong with this end: a traceback, or no single line that says why."""
        errors = [line for line in self.said if line.startswith("error: ")]
        if self.code is None:
            return f"hung: {self.said[-1:]}"
        if any(line.startswith("Traceback") for line in self.said):
            return f"traceback: {self.said[-1]:.200}"
        if self.code == 2 and len(errors) != 1:
            return f"{len(errors)} lines of error: {self.said[-3:]}"
        if self.code in (0, 2, 128 + signal.SIGINT, -signal.SIGKILL, -signal.SIGTERM):
            return None
        return f"exit code {self.code}: {self.said[-1:]}"


class Started:
    """A process that does a job.

    Attributes:
      process: the process.
    """

    def __init__(self, process: ForkServerProcess, said: pathlib.Path):
        """Starts it; it writes its standard error to the file `said`."""
        self.process = process
        self._said = said
        process.start()

    def send(self, number: signal.Signals) -> None:
        """Sends a signal, unless it has ended."""
        if self.process.is_alive() and self.process.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process.pid, number)

    def end(self, patience: float) -> Ended:
        """Waits for its end, or kills it after `patience` seconds."""
        self.process.join(patience)
        has_hung = self.process.is_alive()
        self.process.kill()
        self.process.join()
        said = reading.read_text(self._said).splitlines() if self._said.exists() else []
        writing.discard(self._said)
        return Ended(None if has_hung else self.process.exitcode, said)


@dataclasses.dataclass(frozen=True)
class Job:
    """A command with little to do.

    Attributes:
      name: which.
      main: does it, as the words of `sys.argv` say.
      words: its command line, without the folder.
      place: where its runs are: `whole`, undisturbed, and `half`, killed on its way.
      chance: draws moments and files.
      seconds: that the undisturbed one took; before it a guess, for all has to be compiled then.
    """

    name: Name
    main: Callable[[], object]
    words: list[str]
    place: pathlib.Path
    chance: random.Random
    seconds: float = 60.0

    @property
    def whole(self) -> pathlib.Path:
        """Folder of the undisturbed run."""
        return self.place / "whole"

    @property
    def half(self) -> pathlib.Path:
        """Folder of the run that was killed on its way."""
        return self.place / "half"

    def start(self, folder: pathlib.Path, limits: Limits = _NONE) -> Started:
        """Starts it in a folder."""
        self.place.mkdir(parents=True, exist_ok=True)
        said = self.place / f"said-{time.monotonic_ns()}.txt"
        words = ["eihrl", *self.words, str(folder)]
        process = _PROCESSES.Process(target=_do, args=(self.main, words, said, limits))
        return Started(process, said)

    def run(self, folder: pathlib.Path, limits: Limits = _NONE) -> Ended:
        """Runs it to its end."""
        return self.end(self.start(folder, limits))

    def end(self, started: Started) -> Ended:
        """Waits for the end of one that has been started, for as long as that may take."""
        return started.end(60.0 + 20.0 * self.seconds)

    def has_something(self, folder: pathlib.Path) -> bool:
        """Returns whether a folder holds something that could be lost."""
        return any(folder.glob(_KEPT[self.name]))

    def make_half(self) -> None:
        """Makes the run that was killed on its way, as soon as it had something to lose."""
        for _ in range(20):
            started = self.start(self.half)
            while started.process.is_alive() and not self.has_something(self.half):
                time.sleep(0.01)
            started.process.join(self.chance.uniform(0.0, 0.3) * self.seconds)
            started.send(signal.SIGKILL)
            if self.end(started).code == -signal.SIGKILL and self.has_something(self.half):
                return
            writing.discard(self.half)
        raise base.UserError(f"{self.name} can't be killed on its way: it is too short")

    def difference(self, folder: pathlib.Path) -> str | None:
        """Says what differs between a run and the undisturbed one, None where nothing does."""
        try:
            found = set(self._numbers(folder))
        except (OSError, base.UserError) as error:
            return f"nothing to compare: {error}"
        differing = {name for name, _ in found ^ set(self._numbers(self.whole))}
        return f"{', '.join(sorted(differing))} differ" if differing else None

    def _numbers(self, folder: pathlib.Path) -> list[tuple[str, object]]:
        """Returns what a run has come to, by name, without when and how fast."""
        if self.name == "report":
            return [("tables.md", reading.read_text(folder / "tables.md"))]
        if self.name == "evaluate":
            cells = results.load(folder / "eval.json").cells
            return [("eval.json", repr(cells)), ("episodes.csv", _rows(folder / "episodes.csv"))]
        if self.name == "dataset":
            files = sorted(path for path in folder.rglob("*") if path.is_file())
            return [
                (path.relative_to(folder).as_posix(), reading.read_bytes(path)) for path in files
            ]

        parameters, _ = policies.load(folder / policies.FOLDER, kind=self.name)
        leaves = jax.tree_util.tree_leaves_with_path(parameters)
        return [
            ("metrics.csv", _rows(folder / "metrics.csv")),
            *((jax.tree_util.keystr(key), np.asarray(leaf).tobytes()) for key, leaf in leaves),
        ]


def undisturbed(name: Name, main: Callable[[], object], place: pathlib.Path, seed: int) -> Job:
    """Makes a job that has run undisturbed, twice: only the second time all is compiled before.

    Args:
      name: which.
      main: does any command, as the words of `sys.argv` say.
      place: where its runs are.
      seed: of moments and files.

    Raises:
      base.UserError: it can't be finished, or its results differ between two runs.
    """
    words, chance = shlex.split(_WORDS[name]), random.Random(f"{seed} {name}")
    job = Job(name, main, words, place, chance)
    for folder in (place / "cold", job.whole):
        start = time.monotonic()
        ended = job.run(folder)
        if ended.code != 0:
            raise base.UserError(f"{name} fails even undisturbed: {ended.said[-1:]}")
        job = dataclasses.replace(job, seconds=time.monotonic() - start)

    difference = job.difference(place / "cold")
    if difference is not None:
        raise base.UserError(f"{name} gives different results when it is repeated: {difference}")
    return job


def _do(main: Callable[[], object], words: list[str], said: pathlib.Path, limits: Limits) -> None:
    """Does a command in this process, which has just been forked off."""
    for number, path in ((1, os.devnull), (2, said)):
        file = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
        os.dup2(file, number)
        os.close(file)
    if limits.bytes is not None:
        most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.bytes, most))
    if limits.is_bound:
        # No capability remains, and so root's right to write anywhere goes.
        version, thread = 0x20080522, 0  # of the third version of `capset`; this one
        ctypes.CDLL(None).capset((ctypes.c_uint32 * 2)(version, thread), (ctypes.c_uint32 * 6)())
    sys.argv = words
    main()


def _rows(file: pathlib.Path) -> str:
    """Returns a run's table, which tells no times; line ends don't count."""
    return repr(list(csv.DictReader(reading.read_text(file).splitlines())))
