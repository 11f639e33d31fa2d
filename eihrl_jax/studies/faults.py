"""Disturbs runs in all ways and goes on with them: `python -m experiments.faults`.

One run of each kind goes through undisturbed. Each of the others is killed, stopped, finds its disk
full, has a file damaged or swapped, or meets another process in its folder, at random moments. It
has to end with the same numbers, bit for bit, or say in one line what is wrong; once that is undone
it must still end so. Other code computes other numbers, so leave the sources alone meanwhile.
"""

import itertools
import os
import pathlib
import random
import shutil
import signal
import sys
from collections.abc import Callable, Iterable
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import limits
from eihrl_jax.evaluation import tables
from eihrl_jax.runs import folders
from eihrl_jax.storage import reading, writing
from eihrl_jax.studies import short_jobs

Fault = Callable[[short_jobs.Job, pathlib.Path], str | None]
"""Disturbs a job in a new folder and ends it; returns what is wrong with how it ended, if anything.
"""

Change = Callable[[list[pathlib.Path], random.Random], dict[pathlib.Path, bytes | None]]
"""Draws some of a folder's files and returns what they are to hold instead; None: they go."""

_ROOM = 64, 40_000
"""Bytes between which the largest file is drawn that a full disk lets through."""

_FOR_EYES = ("tensorboard", "learning_curve.png")


@limits.dataclass
class FaultsConfig:
    """Disturbs trainings, evaluations, reports and datasets, and compares what they end with.

    Attributes:
      jobs: what is disturbed; dataset needs Minari.
      faults: how often each, by one kind of fault after the other.
      run: folder for all the runs; must not exist.
      seed: of moments, files and places in them.
    """

    jobs: limits.Several[short_jobs.Name] = ("high", "low", "baseline", "evaluate", "report")
    faults: Annotated[int, limits.Range(1, 10_000)] = 20
    run: pathlib.Path = pathlib.Path("runs/faults")
    seed: limits.Seed = 0


def main(options: FaultsConfig, command: Callable[[], object]) -> None:
    """Disturbs all jobs and prints a table; ends with exit code 1 where anything was lost.

    Args:
      options: what is disturbed.
      command: does any command, as the words of `sys.argv` say.

    Raises:
      base.UserError: the folder isn't free, or a job doesn't even end undisturbed.
    """
    if options.run.exists():
        raise base.UserError(f"{options.run} exists already: name another --run")
    options.run.mkdir(parents=True)
    # All processes share one, so that next to nothing is compiled: most of the time is spent on
    # what is disturbed. Whoever has set one of these decides it.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(options.run.absolute() / "programs"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

    rows, num_lost = [], 0
    for name in options.jobs:
        job = short_jobs.undisturbed(name, command, options.run / name, options.seed)
        print(f"{name}: undisturbed {job.seconds:.1f} s", flush=True)
        job.make_half()
        told: dict[str, list[str | None]] = {kind: [] for kind in FAULTS}
        for index, kind in zip(range(options.faults), itertools.cycle(FAULTS)):
            folder = job.place / f"{index:03d}"
            mistake = disturbed(job, kind, folder)
            told[kind].append(mistake)
            print(f"{name} {folder.name}, {kind}: {mistake or 'as undisturbed'}", flush=True)
            if mistake is None:
                shutil.rmtree(folder)

        for kind, each in told.items():
            rows.append([name, kind, str(len(each)), str(each.count(None))])
            num_lost += len(each) - each.count(None)
    header = ["job", "fault", "tried", "as undisturbed"]
    tables.show([tables.on_terminal(tables.Table("", header, rows, num_words=2))])
    sys.exit(num_lost > 0)


def disturbed(job: short_jobs.Job, kind: str, folder: pathlib.Path) -> str | None:
    """Disturbs a job in a new folder, goes on with it, and says what was wrong or lost.

    Args:
      job: which.
      kind: one of `FAULTS`.
      folder: doesn't exist.
    """
    mistake = FAULTS[kind](job, folder)
    if mistake is not None:
        return mistake
    ended = job.run(folder)
    # What is complete may refuse to be made again.
    difference = job.difference(folder)
    if difference is not None and ended.code != 0:
        return f"can't go on: {ended.said[-1:]}"
    return ended.mistake() or difference


def _signalled(*signals: signal.Signals) -> Fault:
    """Returns the fault of getting signals, the first at a random moment, others soon after."""

    def disturb(job: short_jobs.Job, folder: pathlib.Path) -> str | None:
        started, wait = job.start(folder), job.chance.uniform(0.0, job.seconds)
        for each in signals:
            started.process.join(wait)
            started.send(each)
            wait = job.chance.uniform(0.0, 1.0)
        return job.end(started).mistake()

    return disturb


def _full(job: short_jobs.Job, folder: pathlib.Path) -> str | None:
    """Finds the disk full: files can't be longer than a limit, which has the same effect."""
    return job.run(folder, short_jobs.Limits(bytes=job.chance.randint(*_ROOM))).mistake()


def _two(job: short_jobs.Job, folder: pathlib.Path) -> str | None:
    """Is started twice in the same folder."""
    mistakes = [job.end(each).mistake() for each in (job.start(folder), job.start(folder))]
    return mistakes[0] or mistakes[1]


def _read_only(job: short_jobs.Job, folder: pathlib.Path) -> str | None:
    """May not write into its folder, nor into those inside."""
    _copy(job, folder)
    inside = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
    for path in inside:
        path.chmod(0o555)
    ended = job.run(folder, short_jobs.Limits(is_bound=True))
    for path in inside:
        path.chmod(0o755)
    return ended.mistake()


def _changed(change: Change) -> Fault:
    """Returns the fault of having files changed, of a run that was killed or is complete."""

    def disturb(job: short_jobs.Job, folder: pathlib.Path) -> str | None:
        _copy(job, folder)
        files = _drawn(folder, job.chance)
        before = {path: reading.read_bytes(path) for path in files}
        changes = change(files, job.chance)
        _write(changes.items())
        ended = job.run(folder)
        if ended.mistake() is not None:
            names = ", ".join(str(path.relative_to(folder)) for path in changes)
            return f"{names}: {ended.mistake()}"

        if ended.code != 0:
            # Refused: with the files as they were, the run must be as it was, too.
            _write((path, before[path]) for path in changes)
        return None

    return disturb


def _copy(job: short_jobs.Job, folder: pathlib.Path) -> None:
    """Copies a run, killed on its way or, more rarely, complete."""
    shutil.copytree(job.chance.choice([job.half, job.half, job.whole]), folder)


def _drawn(folder: pathlib.Path, chance: random.Random) -> list[pathlib.Path]:
    """Returns the files of a folder that hold numbers or what a run needs, in a random order."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    counting = [
        path
        for path in files
        if path.name != folders.LOCK and path.relative_to(folder).parts[0] not in _FOR_EYES
    ]
    chance.shuffle(counting)
    # A checkpoint has many files, options and metrics have one each: all kinds come equally often.
    kinds: dict[str, list[pathlib.Path]] = {}
    for path in counting:
        kinds.setdefault(path.relative_to(folder).parts[0], []).append(path)
    order = list(kinds)
    chance.shuffle(order)
    return [path for kind in order for path in kinds[kind]]


def _write(contents: Iterable[tuple[pathlib.Path, bytes | None]]) -> None:
    """Gives files other contents, or removes them."""
    for path, data in contents:
        if data is None:
            writing.discard(path)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with writing.new_file(path) as file:
            file.write(data)


def _flipped(files: list[pathlib.Path], chance: random.Random) -> dict[pathlib.Path, bytes | None]:
    """Flips one bit of a file."""
    data = bytearray(reading.read_bytes(files[0]) or b"\0")
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return {files[0]: bytes(data)}


def _cut(files: list[pathlib.Path], chance: random.Random) -> dict[pathlib.Path, bytes | None]:
    """Keeps the beginning of a file."""
    data = reading.read_bytes(files[0])
    return {files[0]: data[: chance.randrange(max(1, len(data)))]}


def _removed(files: list[pathlib.Path], chance: random.Random) -> dict[pathlib.Path, bytes | None]:
    """Removes a file."""
    del chance
    return {files[0]: None}


def _swapped(files: list[pathlib.Path], chance: random.Random) -> dict[pathlib.Path, bytes | None]:
    """Gives two files each other's contents."""
    del chance
    one, other = files[0], files[-1]
    return {one: reading.read_bytes(other), other: reading.read_bytes(one)}


FAULTS: dict[str, Fault] = {
    "SIGKILL": _signalled(signal.SIGKILL),
    "SIGTERM": _signalled(signal.SIGTERM),
    "Ctrl-C twice": _signalled(signal.SIGINT, signal.SIGINT),
    "disk full": _full,
    "read-only folder": _read_only,
    "two at once": _two,
    "a bit of a file": _changed(_flipped),
    "a file cut short": _changed(_cut),
    "a file removed": _changed(_removed),
    "two files swapped": _changed(_swapped),
}
"""What happens to a job in a folder, by name."""
