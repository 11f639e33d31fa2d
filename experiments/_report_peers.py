"""Learning of ours and the baselines for `experiments.report` (paper, Figures 5 and 6)."""

import csv
import itertools
import pathlib
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from eihrl_jax import base, mazes, robots
from eihrl_jax.evaluation import curves, page, results, tables
from experiments import _runs

LINES = {
    "ours, walking": ("ours", "walking"),
    "ours, oracle": ("ours", "eval"),
    "flat DroQ": ("droq", "eval"),
    "HIGL": ("higl", "eval"),
    "HESS": ("hess", "eval"),
    "HRAC": ("hrac", "eval"),
    "HIRO": ("hiro", "eval"),
}
"""What the pictures show: method of `compare_peers`, and which of its evaluations."""

RAND_H = "RAND-H"
"""What the paper calls uniform directions."""

LONG = "ours, oracle, long"

_MEASURES: dict[base.Reward, tuple[str, ...]] = {
    "sparse": ("success",),
    "dense": ("reward", "success"),
}
_UNITS = {"success": ("success, %", 100.0), "reward": ("reward per step", 1.0)}

_STYLES = ("ours, walking", "ours, oracle", "flat DroQ", "HIGL", "HESS", RAND_H, LONG)
"""Order in which lines are given to labels: those of one colour belong together."""

_SPENT = 0.9
"""Share of the greatest budget from which on a run's budget is spent: rows differ in length."""

Curve = Float[np.ndarray, "N 2"]


def section(
    long: Callable[[str], list[pathlib.Path]], peers: pathlib.Path | None, out: pathlib.Path
) -> page.Section:
    """Draws success, and dense reward's mean per step, against episodes and control steps.

    Args:
      long: finds the metrics of our high levels trained alike, e.g. "best-u" or "best-u-dense".
      peers: folder of `compare_peers`, `<method>-<maze>[-dense]-<seed>` each; None: no picture.
      out: folder of the pictures.

    Raises:
      base.UserError: `peers` holds no such run.
    """
    pictures, at_the_end = [], []
    if peers is not None:
        for maze, reward in itertools.product(mazes.NAMES, base.REWARDS):
            pictures += _pictures(long, peers, maze, reward, out)
        if not pictures:
            raise base.UserError(f"peers = {peers} holds no <method>-<maze>-<seed>")
        at_the_end = [_at_the_end(peers, reward) for reward in base.REWARDS]
    return page.Section(
        title="Learning at equal budgets (Figures 5 and 6)",
        text="All are evaluated without exploration. The baselines walk while they learn. Our high "
        "level learns moved by the oracle: a decision counts as the ant's 25 control steps, and "
        "the low level with which it then walks was trained before, which isn't counted. "
        f"{LONG}: the high levels of the other parts, with more workers and a greater budget.",
        tables=[table for table in at_the_end if table.rows],
        pictures=pictures,
    )


def _at_the_end(peers: pathlib.Path, reward: base.Reward) -> tables.Table:
    """Compares the last evaluations of all methods, their mean and range over seeds."""
    found: dict[str, dict[str, str]] = {}
    for maze in mazes.NAMES:
        drawn = _at_equal_budgets(peers, _runs.task(maze, reward), "success", _by_steps)
        for label, lines in drawn.items():
            last = 100.0 * np.array([line[-1, 1] for line in lines])
            text = f"{last.mean():.0f} ({last.min():.0f} to {last.max():.0f}), {len(last)}"
            found.setdefault(label, {})[maze] = text
    shown = [maze for maze in mazes.NAMES if any(maze in cells for cells in found.values())]
    rows = [
        [label, *(found[label].get(maze, "-") for maze in shown)]
        for label in (*LINES, RAND_H)
        if label in found
    ]
    title = f"Success in % when the budget is spent, {reward} reward: mean (range), seeds"
    return tables.Table(title, ["method", *shown], rows)


def _pictures(
    long: Callable[[str], list[pathlib.Path]],
    peers: pathlib.Path,
    maze: str,
    reward: base.Reward,
    out: pathlib.Path,
) -> list[page.Picture]:
    """Draws a task against both axes; nothing where no method has learned it."""
    task = _runs.task(maze, reward)
    pictures = []
    for y, (axis, read) in itertools.product(_MEASURES[reward], _AXES.items()):
        drawn = _at_equal_budgets(peers, task, y, read)
        if not drawn:
            break
        if files := long(f"best-{task}"):
            drawn[LONG] = [read(file, f"eval/{y}") for file in files]
        label, scale = _UNITS[y]
        path = out / f"peers-{task}-{y}-{axis.replace(' ', '-')}.png"
        out.mkdir(parents=True, exist_ok=True)
        curves.save_spread(
            path,
            drawn,
            x_label=axis,
            y_label=label,
            y_scale=scale,
            has_log_x=True,
            labels=_STYLES,
        )
        text = f"{maze}, {reward} reward: {y} against {axis}, mean and range over seeds."
        pictures.append(page.Picture(path, text))
    return pictures


def _at_equal_budgets(
    folder: pathlib.Path, task: str, y: str, read: Callable[[pathlib.Path, str], Curve]
) -> dict[str, list[Curve]]:
    """Reads the curves of each method in a task and of RAND-H; none if no method has learned it."""
    found = _lines(folder, task, y, read)
    return found | _flat(folder, task, y, found) if found else {}


def _lines(
    folder: pathlib.Path, task: str, y: str, read: Callable[[pathlib.Path, str], Curve]
) -> dict[str, list[Curve]]:
    """Reads the curves of each method in a task, one per seed."""
    found = {}
    for label, files in _finished(folder, task).items():
        if lines := [line for file in files if len(line := read(file, f"{LINES[label][1]}/{y}"))]:
            found[label] = lines
    return found


def _finished(folder: pathlib.Path, task: str) -> dict[str, list[pathlib.Path]]:
    """Lists the metrics of each method in a task that have spent the greatest budget of them all.

    What hasn't been evaluated near there yet is still being trained, and left out.
    """
    ends: dict[str, dict[pathlib.Path, float]] = {}
    for label, (method, name) in LINES.items():
        for run in _runs.seeds_of(folder, f"{method}-{task}"):
            file = run / "metrics.csv"
            if file.is_file() and _is_evaluated(file, name):
                end = float(_by_steps(file, f"{name}/success")[-1, 0])
                ends.setdefault(label, {})[file] = end
    spent = _SPENT * max((end for files in ends.values() for end in files.values()), default=0.0)
    return {
        label: [file for file, end in files.items() if end >= spent]
        for label, files in ends.items()
    }


def _is_evaluated(file: pathlib.Path, name: str) -> bool:
    """Tells whether a run has been evaluated; its file may be empty until then."""
    if f"{name}/success" not in curves.columns(file):
        return False
    with file.open(newline="") as text:
        return any(row[f"{name}/success"] for row in csv.DictReader(text))


def _flat(
    folder: pathlib.Path, task: str, y: str, others: dict[str, list[Curve]]
) -> dict[str, list[Curve]]:
    """Returns RAND-H, which learns nothing, as lines along all other curves."""
    x = np.concatenate([curve[:, 0] for curves in others.values() for curve in curves])
    lines = []
    for run in _runs.seeds_of(folder, f"rand_h-{task}"):
        cell = results.load(run / "eval.json").cells[0]
        value = cell.success.rate if y == "success" else cell.return_mean / cell.decisions_mean
        lines.append(np.array([[x.min(), value], [x.max(), value]]))
    return {RAND_H: lines} if lines else {}


def _by_steps(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against control steps."""
    if "num_decisions" not in curves.columns(file):
        return curves.read(file, "step", y)
    return curves.read(file, "num_decisions", y) * [robots.load("ant").steps_per_subgoal, 1.0]


def _by_episodes(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against the episodes that had ended, from the first one on."""
    if "episodes" in curves.columns(file):
        x = "step"
        done, ended = curves.read(file, x, "episodes").T
    else:
        # Shipped metrics: what was decided since the last row, over the mean length of what ended.
        x = "num_decisions"
        done, length = curves.read(file, x, "decisions").T
        ended = np.diff(done, prepend=0.0) / length
    found = curves.read(file, x, y)
    found[:, 0] = np.interp(found[:, 0], done, np.cumsum(ended))
    return found[found[:, 0] > 0.0]


_AXES: dict[str, Callable[[pathlib.Path, str], Curve]] = {
    "episodes": _by_episodes,
    "control steps": _by_steps,
}
