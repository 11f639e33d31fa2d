"""The one training loop: resume, advance, evaluate, log, checkpoint, and the policy at the end.

What is trained is a `Job`: the low level, the high level and the baselines each have one.
"""

import dataclasses
import math
import pathlib
from collections.abc import Callable, Collection, Mapping
from typing import Protocol, TypeVar, runtime_checkable

from jaxtyping import Array

from eihrl_jax import base
from eihrl_jax.runs import checkpoint, policies, run_folder, versions
from eihrl_jax.runs import progress as progress_lib

StateT = TypeVar("StateT")

Metrics = Mapping[str, Array]
"""What compiled training measures, see `Job.row`."""

Advance = Callable[[StateT], tuple[StateT, Metrics]]
"""Trains for `Plan.log_every` steps; consumes the state."""

Evaluate = Callable[[StateT, int], dict[str, float]]
"""Evaluates a state that has done so many steps; its metrics' names have their prefix already."""


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
      may_change: options that may differ when a run goes on.
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

    def finish(self, path: pathlib.Path, state: StateT) -> tuple[base.Params, policies.Meta]:
        """Ends a run.

        Args:
          path: the run folder, for what the run leaves besides its policy.
          state: the last one.

        Returns:
          The policy's parameters, and the JSON values that must stand beside them.
        """
        ...


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


def run(job: Job[StateT], config: Options) -> float:
    """Trains in a run folder from the start, or from where the run was stopped, to the end.

    Where several processes train together all must call this; the first one writes.

    Args:
      job: what is trained.
      config: the run's options, a dataclass.

    Returns:
      Seconds of training past compilation, evaluations and checkpoints included.

    Raises:
      base.UserError: the run folder is not as it should be.
    """
    plan = job.plan
    _check_length(plan, config)  # before the folder's config is written anew
    with run_folder.RunFolder.create(
        config.run, config, resume=config.resume, may_change=plan.may_change
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
            state = _train(job, state, done, folder, progress)
            seconds = progress.seconds
        # Also where nothing was left to train: a kill may have come just before the policy.
        _finish(job, state, folder)
    return seconds


def _train(
    job: Job[StateT],
    state: StateT,
    done: int,
    folder: run_folder.RunFolder,
    progress: progress_lib.Progress,
) -> StateT:
    """Trains from the step `done` to the end, and returns the last state."""
    plan = job.plan
    # Both before the first step, so that an evaluation that can't be compiled costs no training.
    with progress.compiling("training"):
        advance = job.compile_training(state)
    with progress.compiling("evaluation"):
        evaluate = job.compile_evaluation(state)
    if done == 0:
        state = job.begin(state, progress)

    while done < plan.num_steps:
        state, metrics = advance(state)
        done += plan.log_every
        is_last = done >= plan.num_steps

        row = job.row(state, metrics)
        if is_last or done % plan.evaluate_every == 0:
            row |= evaluate(state, done)
        folder.log(done, row)
        progress.update(done * plan.units_per_step, _shown(plan, row))

        # After the row of the same step, which a run that goes on from here doesn't write again.
        if is_last or done % plan.checkpoint_every == 0:
            folder.save(done, state)
    return state


def _finish(job: Job[StateT], state: StateT, folder: run_folder.RunFolder) -> None:
    """Writes the policy, last of all: a run that has one is complete."""
    params, meta = job.finish(folder.path, state)
    policies.save(
        folder.path / policies.FOLDER,
        kind=job.plan.kind,
        params=params,
        meta=meta | {"versions": versions.describe()},
        overwrite=True,  # a run that was longer than its first end has one already
    )


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
