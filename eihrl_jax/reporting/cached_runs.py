"""Runs of commands that can be stopped and started again: each run has a name and is made once."""

import dataclasses
import functools
import json
import pathlib
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from eihrl_jax import base
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import codec
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import low as low_config
from eihrl_jax.evaluation import results
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import checkpoint, folders, policies
from eihrl_jax.storage import reading

Run = low_config.LowConfig | high_config.HighConfig | baselines_config.BaselineConfig
RunT = TypeVar("RunT", bound=Run)

MAZES = ("random", "u", "s", "spiral")
"""Mazes that the paper trains in (Tables 1 to 3, Figures 5 and 6)."""

_SECONDS_BETWEEN_LOOKS = 10.0
"""After which a process that has nothing else to do looks whether another one was killed."""


def task(maze: str, reward: base.Reward) -> str:
    """Names a task: `<maze>[-dense]`."""
    return maze if reward == "sparse" else f"{maze}-{reward}"


def name(what: str, maze: str, reward: base.Reward, seed: int) -> str:
    """Names a run folder: `<what>-<maze>[-dense]-<seed>`, as the report finds it."""
    return f"{what}-{task(maze, reward)}-{seed}"


def seeds_of(folder: pathlib.Path, run: str) -> list[pathlib.Path]:
    """Lists the folders `<run>-<seed>` that there are, by seed."""
    # What follows may also be another word: `higl-u-dense-0` is no seed of `higl-u`.
    runs = {path.name.removeprefix(f"{run}-"): path for path in folder.glob(f"{run}-*")}
    return [runs[seed] for seed in sorted(filter(str.isdecimal, runs), key=int)]


def checked(options: RunT, train: Callable[[RunT], object]) -> Callable[[], None]:
    """Checks a run, and returns the function that trains it to its end, see `finish`.

    Raises:
      base.UserError: it has been done with other options, or is damaged.
    """
    is_finished(options)
    return functools.partial(finish, options, train)


def finish(options: RunT, train: Callable[[RunT], object]) -> None:
    """Trains a run to its end, if that hasn't been done; `options` resume.

    Raises:
      base.UserError: it has been done with other options.
      folders.TakenError: another process is at it.
    """
    if not is_finished(options):
        folders.check_unlocked(options.run)  # before anything is compiled
        train(options)


def share(jobs: Iterable[Callable[[], object]]) -> None:
    """Does jobs one after the other, those that another process is at last of all.

    So a command that is started several times with one folder, on one or several hosts, shares its
    runs among its processes. What a killed process leaves, another one goes on with.

    Args:
      jobs: each does nothing if it has been done, and raises `folders.TakenError` while another
        process does it.
    """
    left, is_told = list(jobs), False
    while left:
        taken = []
        for job in left:
            try:
                job()
            except folders.TakenError:
                taken.append(job)
        if len(taken) == len(left):
            if not is_told:
                print(f"waiting for {len(taken)} of other processes", file=sys.stderr)
            is_told = True
            time.sleep(_SECONDS_BETWEEN_LOOKS)
        left = taken


def is_finished(options: Run) -> bool:
    """Returns whether a run has its policy, and not one from before it was extended.

    Raises:
      base.UserError: it was trained with other options than it would be now, or is damaged.
    """
    policy = options.run / policies.FOLDER
    if not checkpoint.is_complete(policy):
        return False

    file = options.run / "config.json"
    if not file.is_file():
        raise base.UserError(f"{options.run} has a policy, but no {file.name}")
    trained = codec.from_json(type(options), reading.read_text(file), source=str(file))
    # The folder may have been moved since, and a run be begun with or without --resume.
    if dataclasses.replace(trained, run=options.run, resume=True) != options:
        raise base.UserError(f"{options.run} was trained with other options: name another --out")

    # A run that was extended and killed has its new options, and still its old policy.
    unit, length = _length(options)
    meta = json.loads(checkpoint.read_file(policy, "meta.json"))
    return policies.entry(meta, unit, policy) >= length


def _length(options: Run) -> tuple[str, int]:
    """Returns what a run counts in, by its policy's name for it, and how many it is to have."""
    if isinstance(options, low_config.LowConfig):
        return "num_iterations", options.num_iterations
    if isinstance(options, high_config.HighConfig):
        return "num_updates", options.learner.num_updates
    return "num_steps", options.num_steps


def evaluated(options: evaluate_config.EvaluateConfig) -> tuple[results.Cell, ...]:
    """Returns the results of an evaluation, made if they aren't there.

    Raises:
      base.UserError: they are there, with other options.
      folders.TakenError: another process is at it.
    """
    if not options.out.exists():
        with folders.locked(options.out.with_name(f"{options.out.name}.lock")):
            _evaluate(options)

    evaluation = results.load(options.out / "eval.json")
    asked = json.loads(codec.to_json(options))
    about = evaluation.about if isinstance(evaluation.about, dict) else {}
    # An option that is newer than the evaluation had its default in it.
    default = json.loads(codec.to_json(evaluate_config.EvaluateConfig()))
    if {**default, **about.get("config", {}), "out": ""} != {**asked, "out": ""}:
        raise base.UserError(f"{options.out} was evaluated with other options: name another --out")
    return evaluation.cells


def _evaluate(options: evaluate_config.EvaluateConfig) -> None:
    """Makes an evaluation, unless another process has made it since."""
    if options.out.exists():
        return
    # Under another name until it is complete: what a kill leaves there is begun anew.
    partial = options.out.with_name(f"{options.out.name}.incomplete")
    shutil.rmtree(partial, ignore_errors=True)
    evaluations.evaluate(dataclasses.replace(options, out=partial))
    partial.rename(options.out)
