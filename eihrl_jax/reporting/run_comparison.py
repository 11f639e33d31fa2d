"""Runs side by side: their curves in one picture, their differences in tables."""

import collections
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.config import runs as runs_config
from eihrl_jax.drawing import curves
from eihrl_jax.evaluation import tables
from eihrl_jax.reporting import learning_curve
from eihrl_jax.runs import checkpoint, metrics_log, policies, progress, run_folder

Options: TypeAlias = dict[str, Any]
"""A run's options by name, see `run_folder.read_options`."""

_OF_NO_MATTER = ("run", "resume", "coordinator", "num_processes", "process_id", "num_devices")
"""Options without influence on what is learned."""

_FIRST = ("method", "preset", "robot", "task.maze", "maze", "task.reward", "reward", "task.robot")
"""Options that are listed first, because others often follow from them."""


def plot(config: runs_config.PlotConfig) -> pathlib.Path:
    """Draws metrics of runs, and returns the picture's path.

    Raises:
      base.UserError: a folder holds no run, or none of them has such a metric.
    """
    files = {run: run / metrics_log.FILE for run in config.runs}
    names = _names({run: run_folder.read_options(run) for run in config.runs})
    columns = {run: curves.columns(file) for run, file in files.items()}
    x = config.x or learning_curve.x_of(_shared(columns.values()))
    _check_known("x", [x], columns.values())
    _check_known("metrics", config.metrics, columns.values())

    panels = []
    for metric in config.metrics or _telling(columns.values()):
        groups: dict[str, list[curves.Curve]] = collections.defaultdict(list)
        for run, file in files.items():
            # A run of another kind, or one that has just begun, has no line here.
            if {x, metric} <= {*columns[run]}:
                line = learning_curve.points(file, x, metric)
                groups[names[run]] += [line] if len(line) else []
        drawn = {name: lines for name, lines in groups.items() if lines}
        if drawn:
            panels.append(_panel(metric, drawn))
    if not panels:
        raise base.UserError(f"{files[config.runs[0]]} holds no numbers of these metrics yet")

    config.out.parent.mkdir(parents=True, exist_ok=True)
    curves.save_panels(config.out, panels, x_label=learning_curve.X_LABELS.get(x, x))
    return config.out


def compare(config: runs_config.CompareRunsConfig) -> list[tables.Table]:
    """Returns a table of the options in which runs differ, and one of their last metrics.

    Raises:
      base.UserError: a folder holds no run, or none of them has such a metric.
    """
    options = {run: run_folder.read_options(run) for run in config.runs}
    columns = {run: curves.columns(run / metrics_log.FILE) for run in config.runs}
    _check_known("metrics", config.metrics, columns.values())

    head = [str(run) for run in config.runs]
    differing = [
        [name, *(_value(options[run], name) for run in config.runs)]
        for name in _differing(options.values())
    ]
    metrics = dict.fromkeys([*_telling(columns.values()), *config.metrics])
    figures = [
        [
            f"{metric}: {learning_curve.quantity_of(metric).label}",
            *(_last(run, columns[run], metric) for run in config.runs),
        ]
        for metric in metrics
    ]
    figures += [
        ["steps", *(_steps(run, columns[run]) for run in config.runs)],
        ["time, compilation included", *(_seconds(run) for run in config.runs)],
        ["state", *(_state(run) for run in config.runs)],
    ]
    same = [] if differing else [["none", *("" for _ in config.runs)]]
    return [
        tables.Table("Options in which they differ", ["option", *head], differing or same),
        tables.Table("What they came to", ["last value", *head], figures),
    ]


def _panel(metric: str, groups: Mapping[str, Sequence[curves.Curve]]) -> curves.Panel:
    """Returns the panel of a metric, with what it measures as its label."""
    quantity = learning_curve.quantity_of(metric)
    when, _, _ = metric.rpartition("/")
    label = quantity.label if not when or quantity.label == metric else f"{when}: {quantity.label}"
    return curves.Panel(y_label=label, groups=groups, y_range=quantity.y_range)


def _shared(columns: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    """Returns the columns that all runs have."""
    first, *others = columns
    return tuple(name for name in first if all(name in other for other in others))


def _telling(columns: Iterable[tuple[str, ...]]) -> list[str]:
    """Lists the metrics of performance: those of evaluations, if there are any."""
    there = dict.fromkeys(name for names in columns for name in names)
    metrics = [name for name in there if name.rpartition("/")[2] in learning_curve.QUANTITIES]
    return [name for name in metrics if "/" in name] or metrics


def _check_known(name: str, metrics: Iterable[str], columns: Iterable[tuple[str, ...]]) -> None:
    """Checks that some run has each of the metrics.

    Raises:
      base.UserError: none has.
    """
    there = dict.fromkeys(column for run in columns for column in run)
    for metric in metrics:
        checks.one_of(name, metric, there)


def _names(options: Mapping[pathlib.Path, Options]) -> dict[pathlib.Path, str]:
    """Names runs by as few options as distinguish them.

    The seed isn't one of them: runs that differ in nothing else get the same name.
    """
    chosen: list[str] = []
    for option in _differing(options.values()):
        # Most options follow from a preset: only what divides further is worth telling.
        finer = [*chosen, option]
        if option != "seed" and _num_kinds(options, finer) > _num_kinds(options, chosen):
            chosen = finer

    if not chosen:
        (name, *others) = (run.name for run in options)
        return dict.fromkeys(options, f"mean of {len(options)} runs" if others else name)
    return {
        run: ", ".join(f"{option} {_value(own, option)}" for option in chosen)
        for run, own in options.items()
    }


def _num_kinds(options: Mapping[pathlib.Path, Options], told: Sequence[str]) -> int:
    """Returns the number of distinct values of some options, taken together."""
    return len({tuple(_value(own, name) for name in told) for own in options.values()})


def _differing(options: Iterable[Options]) -> list[str]:
    """Lists the options in which runs differ, those of `_FIRST` first."""
    runs = [*options]
    names = dict.fromkeys(name for run in runs for name in run)
    ordered = [name for name in _FIRST if name in names] + [n for n in names if n not in _FIRST]
    return [
        name
        for name in ordered
        if name not in _OF_NO_MATTER
        and any(_value(run, name) != _value(runs[0], name) for run in runs)
    ]


def _value(options: Options, name: str) -> str:
    """Writes the value of an option; a run of another kind may not have it."""
    return str(options[name]) if name in options else "-"


def _last(run: pathlib.Path, columns: tuple[str, ...], metric: str) -> str:
    """Writes the last value of a metric."""
    if metric not in columns:
        return "-"
    line = learning_curve.points(run / metrics_log.FILE, "step", metric)
    return f"{line[-1, 1]:.{learning_curve.quantity_of(metric).digits}f}" if len(line) else "-"


def _steps(run: pathlib.Path, columns: tuple[str, ...]) -> str:
    """Formats a run's steps, in the run's own unit."""
    x = learning_curve.x_of(columns)
    if x not in columns:
        return "0"
    line = curves.read(run / metrics_log.FILE, x, x, may_be_empty=True)
    return f"{line[-1, 0]:,.0f} {learning_curve.X_LABELS[x]}" if len(line) else "0"


def _seconds(run: pathlib.Path) -> str:
    """Writes how long a run has taken, all its starts together."""
    seconds = sum(start.get("seconds", 0.0) for start in run_folder.read_starts(run))
    return progress.format_seconds(seconds) if seconds else "-"


def _state(run: pathlib.Path) -> str:
    """Says whether a run is finished."""
    return "finished" if checkpoint.is_complete(run / policies.FOLDER) else "not finished"
