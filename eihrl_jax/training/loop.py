"""The one training loop: resume, advance, evaluate, log, checkpoint, and the policy at the end.

Ctrl-C ends a run with a checkpoint, and checkpoints are also written by the clock: whatever the
options say, little is lost.

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
"""What compiled training measures, see `Job.row`."""

Advance = Callable[[StateT], tuple[StateT, Metrics]]
"""Trains for `Plan.log_every` steps; consumes the state."""

Evaluate = Callable[[StateT, int], dict[str, float]]
"""Evaluates a state that has done so many steps; its metrics' names have their prefix already."""

Watch = Callable[[pathlib.Path], object]
"""Called with the run folder after each checkpoint, by the first process, to draw what is new."""

SECONDS_BETWEEN_SAVES = 20.0
"""Checkpoints are no rarer than this, unless saving would take more than `_SAVING_SHARE`."""

_MAY_ALWAYS_CHANGE = ("evaluate_every", "checkpoint_every")
"""Options that may differ when a run goes on: what is trained depends on none of them."""

_PIECES_TIMED = 3
"""Compiled pieces of training after which it is told how long all will take."""

_SAVING_SHARE = 0.05  # of a run's time


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run trains and when it does what, all in the steps that its job counts in.

    Attributes:
      kind: what the policy is of.
      title: what is trained, in a few words.
      num_steps: length of the run, which ends with the first row that reaches it.
      log_every: steps of one compiled piece of training, which makes one row of metrics.
      evaluate_every: steps between evaluations, a multiple of `log_every`.
      checkpoint_every: steps between checkpoints, a multiple of `log_every`.
      length_option: the option by which `num_steps` is known to the user.
      may_change: options that may differ when a run goes on, besides the intervals of evaluations
        and checkpoints.
      shown: metrics that are shown while the run goes on, with the names under which they are.
      unit: what is counted then.
      units_per_step: how many of it a step has.
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
    """What is trained; its state holds all that a run needs to go on, random keys included."""

    @property
    def plan(self) -> Plan:
        """What the run trains, and when it does what."""
        ...

    @property
    def sources(self) -> sources_lib.Sources:
        """Files by which some options name what the run is made of, by option."""
        return {}

    def init(self) -> StateT:
        """Returns the first state of a run, the same for every start of it."""
        ...

    def compile_training(self, state: StateT) -> Advance[StateT]:
        """Compiles training of states that are shaped and placed as this one."""
        ...

    def compile_evaluation(self, state: StateT) -> Evaluate[StateT]:
        """Compiles evaluation of states that are shaped and placed as this one."""
        ...

    def begin(self, state: StateT, progress: progress_lib.Progress) -> StateT:
        """Does what precedes the first step of a new run, if anything does.

        A run that goes on has it behind it.
        """
        return state

    def row(self, state: StateT, metrics: Metrics) -> dict[str, float]:
        """Makes a row of numbers of what `Advance` returned."""
        ...

    def policy(self, state: StateT) -> tuple[base.Params, policies.Meta]:
        """Returns the policy's parameters, and the JSON values that must stand beside them."""
        ...

    def finish(self, path: pathlib.Path, state: StateT) -> policies.Meta:
        """Ends a run.

        Args:
          path: the run folder, for what the run leaves besides its policy.
          state: the last one.

        Returns:
          What else must stand beside the final policy's parameters.
        """
        del path, state
        return {}


@runtime_checkable
class Options(Protocol):
    """What the config of every run has."""

    @property
    def run(self) -> pathlib.Path:
        """The run folder, made by the run."""
        ...

    @property
    def resume(self) -> bool:
        """Whether the run that the folder holds goes on."""
        ...


def run(job: Job[StateT], config: Options, watch: Watch | None = None) -> float:
    """Trains in a run folder from the start, or from where the run was stopped, to the end.

    Where several processes train together all must call this; the first one writes.

    Args:
      job: what is trained.
      config: the run's options, a dataclass.
      watch: draws what is new.

    Returns:
      Seconds of training past compilation, evaluations and checkpoints included.

    Raises:
      base.UserError: the run folder is not as it should be.
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
        # Resume: the last checkpoint takes the place of the first state, later rows are dropped.
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
                # Also where nothing was left to train: a kill may have come before the policy.
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
    """Trains from the step `done` to the end, and returns the last state."""
    plan, clock = job.plan, _SaveClock()
    if done >= plan.num_steps:
        return state  # Nothing is compiled for a run that only lacks its policy.

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

            # After the row of the same step, which a run that goes on doesn't write again.
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
    """Writes a checkpoint, the policy that it holds, and whatever `watch` draws."""
    folder.save(done, state)
    _save_policy(folder.path / policies.LATEST, job.plan.kind, *job.policy(state))
    if watch is not None and jax.process_index() == 0:
        watch(folder.path)


def _finish(job: Job[StateT], state: StateT, folder: run_folder.RunFolder) -> None:
    """Writes the policy, last of all: a run that has one is complete."""
    params, meta = job.policy(state)
    meta |= job.finish(folder.path, state) | {"versions": versions.describe()}
    _save_policy(folder.path / policies.FOLDER, job.plan.kind, params, meta)
    if jax.process_index() == 0:
        shutil.rmtree(folder.path / policies.LATEST, ignore_errors=True)


def _save_policy(
    path: pathlib.Path, kind: policies.Kind, params: base.Params, meta: policies.Meta
) -> None:
    """Writes a policy in place of an earlier one of the same run."""
    policies.save(path, kind=kind, params=params, meta=meta, overwrite=True)


class _SaveClock:
    """Tells when a checkpoint is due by the time that has passed."""

    def __init__(self) -> None:
        """Begins with what is stored already."""
        self._saved = self._looked = time.monotonic()
        self._piece = self._cost = 0.0

    def is_due(self) -> bool:
        """Returns whether another piece as long as the last one would be too late for the next."""
        now = time.monotonic()
        self._looked, self._piece = now, now - self._looked
        limit = max(SECONDS_BETWEEN_SAVES, self._cost / _SAVING_SHARE)
        return now + self._piece - self._saved > limit

    @contextlib.contextmanager
    def saving(self) -> Iterator[None]:
        """Notes when the block has saved, and how long it took."""
        start = time.monotonic()
        yield
        self._saved = self._looked = time.monotonic()
        self._cost = self._saved - start


def _agreed(*flags: bool) -> list[bool]:
    """Returns flags that are the same in all processes of a run: set where one has them set."""
    if jax.process_count() == 1:
        return list(flags)
    return multihost_utils.process_allgather(np.array(flags)).any(axis=0).tolist()


def _kept(plan: Plan, path: pathlib.Path) -> str:
    """Says what a run that is stopped leaves."""
    step = checkpoint.last_step(path / run_folder.CHECKPOINTS)
    return f"{path} keeps " + ("nothing yet" if step is None else _share(plan, step))


def _share(plan: Plan, done: int) -> str:
    """Says how far a run is."""
    num, total = done * plan.units_per_step, plan.num_steps * plan.units_per_step
    return f"{num:,} of {total:,} {plan.unit} ({100 * num / total:.0f} %)"


def _check_length(plan: Plan, config: Options) -> None:
    """Refuses to end a run before the point that it has reached."""
    if not config.resume or plan.length_option not in plan.may_change:
        return
    done = checkpoint.last_step(config.run / run_folder.CHECKPOINTS) or 0
    # The last row may have gone beyond the end by less than its own length.
    if done - plan.log_every >= plan.num_steps:
        length = f"{plan.length_option} = {plan.num_steps}"
        raise base.UserError(f"{length} is less than {config.run} has walked: {done}")


def _shown(plan: Plan, row: Mapping[str, float]) -> dict[str, float]:
    """Picks what is shown of a row; what it has no number for stays as it was."""
    return {
        short: row[name]
        for name, short in plan.shown.items()
        if math.isfinite(row.get(name, math.nan))
    }
