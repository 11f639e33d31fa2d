"""The training loop of all runs: resume, advance, evaluate, log, checkpoint, and save the policy.

Ctrl-C ends a run with a checkpoint. Checkpoints are also written at intervals of time, so that a
killed run loses little whatever its options are.

What is trained is a `Job`: the low level, the high level and the baselines each have one.
"""

import contextlib
import dataclasses
import math
import pathlib
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Protocol, TypeVar, runtime_checkable

import jax
import numpy as np
from jax.experimental import multihost_utils
from jaxtyping import Array

from eihrl_jax import base
from eihrl_jax.runs import checkpoint, policies, run_folder, stopping, versions
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.runs import sources as sources_lib

StateT = TypeVar("StateT")

Metrics = Mapping[str, Array]
"""Metrics of compiled training, on the device; `Job.row` converts them."""

Advance = Callable[[StateT], tuple[StateT, Metrics]]
"""Trains for `Plan.log_every` steps; the given state is donated, so it can't be used again."""

Evaluate = Callable[[StateT, int], dict[str, float]]
"""Evaluates the state after so many steps; returns metrics by their full names."""

Watch = Callable[[pathlib.Path], object]
"""Called with the run folder after each checkpoint, in the first process, to update pictures."""

SECONDS_BETWEEN_SAVES = 20.0
"""Most seconds between checkpoints, unless saving would then take more than `_SAVING_SHARE`."""

_MAY_ALWAYS_CHANGE = ("evaluate_every", "checkpoint_every")
"""Options that may differ when a run is resumed, because they don't change what is trained."""

_PIECES_TIMED = 3
"""Calls of compiled training after which the remaining time is estimated and printed."""

_SAVING_SHARE = 0.05  # of a run's time


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """A run's length and intervals, in the steps that its job counts.

    Attributes:
      kind: of the policy.
      title: of the progress bar.
      num_steps: length of the run, which ends with the first row of metrics that reaches it.
      log_every: steps of one call of compiled training, which makes one row of metrics.
      evaluate_every: steps between evaluations, a multiple of `log_every`.
      checkpoint_every: steps between checkpoints, a multiple of `log_every`.
      length_option: the user's name for `num_steps`.
      may_change: options that may differ when a run is resumed, besides the intervals of
        evaluations and checkpoints.
      shown: metrics in the progress bar, each with a short name.
      unit: what the progress bar counts.
      units_per_step: units of one step.
    """

    kind: policies.Kind
    title: str
    num_steps: int
    log_every: int
    evaluate_every: int
    checkpoint_every: int
    length_option: str
    may_change: Collection[str]
    shown: Mapping[str, str]
    unit: str = "steps"
    units_per_step: int = 1


@runtime_checkable
class Job(Protocol[StateT]):
    """What is trained. Its state holds everything needed to resume a run, random keys included."""

    @property
    def plan(self) -> Plan:
        """The run's length and intervals."""
        ...

    @property
    def sources(self) -> sources_lib.Sources:
        """Files that options of the run name, by option, such as a maze's or a robot's."""
        return {}

    def init(self) -> StateT:
        """Returns the initial state, the same at every start of the run."""
        ...

    def compile_training(self, state: StateT) -> Advance[StateT]:
        """Compiles training for states of this one's shapes and placement."""
        ...

    def compile_evaluation(self, state: StateT) -> Evaluate[StateT]:
        """Compiles evaluation for states of this one's shapes and placement."""
        ...

    def begin(self, state: StateT, progress: progress_lib.Progress) -> StateT:
        """Prepares the first step of a new run, such as by filling a replay.

        Not called when a run is resumed after its first checkpoint.
        """
        return state

    def row(self, state: StateT, metrics: Metrics) -> dict[str, float]:
        """Converts what `Advance` returned to a row of numbers."""
        ...

    def policy(self, state: StateT) -> tuple[base.Params, policies.Meta]:
        """Returns the policy's parameters, and the JSON values from which it can be rebuilt."""
        ...

    def finish(self, path: pathlib.Path, state: StateT) -> policies.Meta:
        """Ends a run.

        Args:
          path: the run folder, for files besides the policy.
          state: the last one.

        Returns:
          Further JSON values for the final policy.
        """
        del path, state
        return {}


@runtime_checkable
class Options(Protocol):
    """Options that every run has."""

    @property
    def run(self) -> pathlib.Path:
        """The run folder, which the run creates."""
        ...

    @property
    def resume(self) -> bool:
        """Whether to resume the run in the folder."""
        ...


def run(job: Job[StateT], config: Options, watch: Watch | None = None) -> float:
    """Trains in a run folder to the end, from the start or from the last checkpoint.

    Where several processes train together, all must call this; the first one writes.

    Args:
      job: what is trained.
      config: the run's options, a dataclass.
      watch: updates pictures.

    Returns:
      Seconds of training, with evaluations and checkpoints but without compilation.

    Raises:
      base.UserError: the run folder exists although a new run is asked for, or holds no run to
        resume, or one with other options or damaged files.
      base.Stopped: Ctrl-C was pressed; its text says what was kept.
    """
    plan = job.plan
    _check_length(plan, config)  # before the folder's config is written anew
    with run_folder.RunFolder.create(
        config.run,
        config,
        resume=config.resume,
        may_change=(*plan.may_change, *_MAY_ALWAYS_CHANGE),
        sources=job.sources,
    ) as folder:
        # Resume: the last checkpoint replaces the initial state; rows logged after it are dropped.
        state = job.init()
        resumed = folder.restore(state)
        done, state = (0, state) if resumed is None else resumed

        with progress_lib.Progress(
            plan.title,
            plan.num_steps * plan.units_per_step,
            unit=plan.unit,
            done=done * plan.units_per_step,
        ) as progress:
            if resumed is not None:
                progress.print(f"{folder.path} goes on from {_share(plan, done)}")
            else:
                total = f"{plan.num_steps * plan.units_per_step:,} {plan.unit}"
                progress.print(
                    f"{plan.title}: {total} into {folder.path}; Ctrl-C keeps what is there"
                )
            try:
                state = _train(job, state, done, folder, progress, watch)
                seconds = progress.seconds
                # Also where nothing was left to train: a run may have been killed just before.
                _finish(job, state, folder)
            except KeyboardInterrupt:
                raise base.Stopped(_kept(plan, folder.path)) from None
    return seconds


def _train(
    job: Job[StateT],
    state: StateT,
    done: int,
    folder: run_folder.RunFolder,
    progress: progress_lib.Progress,
    watch: Watch | None,
) -> StateT:
    """Trains from step `done` to the end, and returns the last state."""
    plan, clock = job.plan, _SaveClock()
    if done >= plan.num_steps:
        return state  # Compile nothing for a run that lacks only its policy.

    # Both before the first step, so that an evaluation that can't be compiled costs no training.
    with progress.compiling("training"):
        advance = job.compile_training(state)
    with progress.compiling("evaluation"):
        evaluate = job.compile_evaluation(state)
    if done == 0:
        state = job.begin(state, progress)

    first, start = done, time.monotonic()
    with stopping.deferred() as stop:
        while done < plan.num_steps:
            state, metrics = advance(state)
            done += plan.log_every
            is_last = done >= plan.num_steps
            if done == first + _PIECES_TIMED * plan.log_every and not is_last:
                each = (time.monotonic() - start) / (done - first)
                left = progress_lib.format_seconds(each * (plan.num_steps - done))
                progress.print(f"{plan.title}: about {left} to go, evaluations left out")

            row = job.row(state, metrics)
            if is_last or done % plan.evaluate_every == 0:
                row |= evaluate(state, done)
            folder.log(done, row)
            progress.update(done * plan.units_per_step, _shown(plan, row))

            # After the row of the same step, which a resumed run doesn't log again.
            is_stopped, is_due = _agreed(stop.is_asked, clock.is_due())
            if is_last or is_stopped or is_due or done % plan.checkpoint_every == 0:
                with clock.saving():
                    _keep(job, state, done, folder, watch)
            if is_stopped and not is_last:
                raise KeyboardInterrupt
    return state


def _keep(
    job: Job[StateT],
    state: StateT,
    done: int,
    folder: run_folder.RunFolder,
    watch: Watch | None,
) -> None:
    """Writes a checkpoint and its policy, and calls `watch`."""
    folder.save(done, state)
    _save_policy(folder.path / policies.LATEST, job.plan.kind, *job.policy(state))
    if watch is not None and jax.process_index() == 0:
        watch(folder.path)


def _finish(job: Job[StateT], state: StateT, folder: run_folder.RunFolder) -> None:
    """Writes the final policy, as the last step: a run that has one is complete."""
    params, meta = job.policy(state)
    meta |= job.finish(folder.path, state) | {"versions": versions.describe()}
    _save_policy(folder.path / policies.FOLDER, job.plan.kind, params, meta)
    if jax.process_index() == 0:
        shutil.rmtree(folder.path / policies.LATEST, ignore_errors=True)


def _save_policy(
    path: pathlib.Path, kind: policies.Kind, params: base.Params, meta: policies.Meta
) -> None:
    """Writes a policy, replacing an earlier one of the same run."""
    policies.save(path, kind=kind, params=params, meta=meta, overwrite=True)


class _SaveClock:
    """Tells when a checkpoint is due because of the time that has passed."""

    def __init__(self) -> None:
        """Starts as if a checkpoint had just been written."""
        self._saved = self._looked = time.monotonic()
        self._piece = self._cost = 0.0

    def is_due(self) -> bool:
        """Returns whether the time limit would pass during another piece as long as the last."""
        now = time.monotonic()
        self._looked, self._piece = now, now - self._looked
        limit = max(SECONDS_BETWEEN_SAVES, self._cost / _SAVING_SHARE)
        return now + self._piece - self._saved > limit

    @contextlib.contextmanager
    def saving(self) -> Iterator[None]:
        """Measures how long saving in the `with` block takes, and restarts the clock."""
        start = time.monotonic()
        yield
        self._saved = self._looked = time.monotonic()
        self._cost = self._saved - start


def _agreed(*flags: bool) -> list[bool]:
    """Returns, in all processes of a run alike, which flags are set in any of them."""
    if jax.process_count() == 1:
        return list(flags)
    return multihost_utils.process_allgather(np.array(flags)).any(axis=0).tolist()


def _kept(plan: Plan, path: pathlib.Path) -> str:
    """Says up to which step a stopped run is kept."""
    step = checkpoint.last_step(path / run_folder.CHECKPOINTS)
    return f"{path} keeps " + ("nothing yet" if step is None else _share(plan, step))


def _share(plan: Plan, done: int) -> str:
    """Says how far a run is."""
    num, total = done * plan.units_per_step, plan.num_steps * plan.units_per_step
    return f"{num:,} of {total:,} {plan.unit} ({100 * num / total:.0f} %)"


def _check_length(plan: Plan, config: Options) -> None:
    """Raises if a resumed run is to be shorter than it already is."""
    if not config.resume or plan.length_option not in plan.may_change:
        return
    done = checkpoint.last_step(config.run / run_folder.CHECKPOINTS) or 0
    # A finished run may exceed its length by less than one row of metrics.
    if done - plan.log_every >= plan.num_steps:
        length = f"{plan.length_option} = {plan.num_steps}"
        raise base.UserError(f"{length} is less than {config.run} has trained: {done}")


def _shown(plan: Plan, row: Mapping[str, float]) -> dict[str, float]:
    """Returns the progress bar's metrics of a row; it keeps old values of those not finite."""
    return {
        short: row[name]
        for name, short in plan.shown.items()
        if math.isfinite(row.get(name, math.nan))
    }
