"""Learning of ours and the baselines for `experiments.report` (paper, Figures 5 and 6)."""

import dataclasses
import functools
import itertools
import pathlib
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from eihrl_jax import base, mazes, robots
from eihrl_jax.drawing import curves, figures
from eihrl_jax.evaluation import paper, results, statistics, tables
from eihrl_jax.reporting import cached_runs, page

_OURS = "ours, walking"

LINES = {
    _OURS: ("ours", "walking"),
    "ours, oracle": ("ours", "eval"),
    "flat DroQ": ("droq", "eval"),
    "HIGL": ("higl", "eval"),
    "HESS": ("hess", "eval"),
    "HRAC": ("hrac", "eval"),
    "HIRO": ("hiro", "eval"),
    "PPO": ("ppo", "eval"),
    "SAC": ("sac", "eval"),
}
"""What the pictures show: method of `compare_baselines`, and which of its evaluations."""

LONG = "ours, oracle, long"

_MEASURES: dict[base.Reward, tuple[str, ...]] = {
    "sparse": ("return", "success"),
    "dense": ("reward", "success"),
}
"""What is drawn. Ours is paid once per decision: dense rewards are means, sparse ones sums."""

_UNITS = {
    "return": ("goals reached per episode", 1.0, 2),
    "reward": ("reward per step", 1.0, 3),
    "success": ("success, %", 100.0, 0),
}
"""Name, factor and decimals of each."""

_STYLES = (_OURS, "ours, oracle", "flat DroQ", "HIGL", "HESS", paper.RAND_H, LONG)
"""Order in which lines are given to labels: those of one colour belong together."""

_SPENT = 0.9
"""Share of the method's budget from which on a run's is spent: rows differ in length."""

Curve = Float[np.ndarray, "N 2"]
Read = Callable[[pathlib.Path, str], Curve]
"""Reads a column of metrics against one of the axes."""


@dataclasses.dataclass(frozen=True)
class Task:
    """The runs of all methods in a maze with a reward.

    Attributes:
      folder: of the runs.
      maze: its name.
      reward: what is paid.
    """

    folder: pathlib.Path
    maze: str
    reward: base.Reward

    @property
    def name(self) -> str:
        """Name of the task in those of runs."""
        return cached_runs.task(self.maze, self.reward)

    @functools.cached_property
    def finished(self) -> dict[str, list[pathlib.Path]]:
        """Metrics by label that have spent the method's budget, the greatest of its runs.

        What hasn't been evaluated near there yet is still being trained, and left out.
        """
        ends: dict[str, dict[pathlib.Path, float]] = {}
        for label, (method, name) in LINES.items():
            for run in cached_runs.seeds_of(self.folder, f"{method}-{self.name}"):
                file = run / "metrics.csv"
                if file.is_file() and _is_evaluated(file, name):
                    end = float(by_steps(file, f"{name}/success")[-1, 0])
                    ends.setdefault(label, {})[file] = end

        # Methods may have budgets of their own: each curve ends where its runs do.
        return {
            label: [file for file, end in files.items() if end >= _SPENT * max(files.values())]
            for label, files in ends.items()
        }

    def curves(self, y: str, read: Read) -> dict[str, list[Curve]]:
        """Reads the curves of each method and of RAND-H, one per seed; none if nothing is finished.

        Args:
          y: a name of `_UNITS`.
          read: reads them.
        """
        learned = {
            label: [read(file, f"{LINES[label][1]}/{y}") for file in files]
            for label, files in self.finished.items()
        }
        # On the axis of episodes a run has no point before the first one has ended.
        drawn = {label: lines for label, all_ in learned.items() if (lines := [*filter(len, all_)])}
        return drawn | self._uniform(y, drawn) if drawn else {}

    def _uniform(self, y: str, others: dict[str, list[Curve]]) -> dict[str, list[Curve]]:
        """Returns RAND-H, which learns nothing, as level lines along all other curves."""
        x = np.concatenate([curve[:, 0] for curves in others.values() for curve in curves])
        lines = []
        for run in cached_runs.seeds_of(self.folder, f"rand_h-{self.name}"):
            cell = results.load(run / "eval.json").cells[0]
            value = {
                "success": cell.success.rate,
                "return": cell.return_mean,
                "reward": cell.return_mean / cell.decisions_mean,
            }[y]
            lines.append(np.array([[x.min(), value], [x.max(), value]]))
        return {paper.RAND_H: lines} if lines else {}

    def ends(self, y: str) -> dict[str, Curve]:
        """Returns the last points of all curves by label, one per seed."""
        return {
            label: np.stack([line[-1] for line in lines])
            for label, lines in self.curves(y, by_steps).items()
        }


Ends = dict[str, dict[str, Curve]]
"""The ends of all methods' curves by maze and label."""


def section(
    long: Callable[[str], list[pathlib.Path]], folder: pathlib.Path | None, out: pathlib.Path
) -> page.Section:
    """Draws success and reward against episodes and control steps, and compares their ends.

    Args:
      long: finds the metrics of our high levels trained alike, e.g. "best-u" or "best-u-dense".
      folder: of the runs of `compare_baselines`, `<method>-<maze>[-dense]-<seed>` each; None: no
        picture.
      out: folder of the pictures.

    Raises:
      base.UserError: the folder holds no such run.
    """
    pictures, at_the_end = [], []
    if folder is not None:
        pairs = itertools.product(mazes.NAMES, base.REWARDS)
        tasks = [task for pair in pairs if (task := Task(folder, *pair)).finished]
        if not tasks:
            raise base.UserError(f"baselines = {folder} holds no <method>-<maze>-<seed>")

        pictures = [picture for task in tasks for picture in _pictures(task, long, out)]

        # A table each for success and for what is paid, in this order.
        ends: dict[tuple[base.Reward, str], Ends] = {}
        for reward in base.REWARDS:
            here = [task for task in tasks if task.reward == reward]
            for y in reversed(_MEASURES[reward]) if here else ():
                ends[reward, y] = {task.maze: task.ends(y) for task in here}
        at_the_end = [_at_the_end(*what, by_maze) for what, by_maze in ends.items()]
        at_the_end.append(_where_ours_is_reached(ends))
    return page.Section(
        title="Learning and its budgets (Figures 5 and 6)",
        text="All are evaluated without exploration. Each method's curve ends with its budget of "
        "control steps, which the tables tell. Bands and ranges are those of the seeds, which of "
        "three seeds is the bootstrapped 95 % interval too; over all mazes it is bootstrapped from "
        "each maze's seeds. The baselines walk while they learn. Our high level learns moved by "
        "the oracle: a decision counts as the ant's 25 control steps, and the low level with which "
        "it then walks was trained before, which isn't counted. Up to 300,000 control steps the "
        "baselines' schedules are shortened, and flat DroQ makes one update per step where 20 are "
        "published (docs/baselines.md). "
        f"{LONG}: the high levels of the other parts, with more workers and a greater budget.",
        tables=[table for table in at_the_end if table.rows],
        pictures=pictures,
    )


def _at_the_end(reward: base.Reward, y: str, ends: Ends) -> tables.Table:
    """Compares the last evaluations of all methods, and tells when they were."""
    rows = []
    for label in (*LINES, paper.RAND_H):
        here = {maze: by_label[label] for maze, by_label in ends.items() if label in by_label}
        if here:
            cells = [_spread(here.get(maze), y) for maze in ends]
            over_all = _over_all([*here.values()], y) if len(here) == len(ends) else "-"
            rows.append([label, *cells, over_all, _budgets(label, here)])
    title = f"{_UNITS[y][0].capitalize()}, {reward} reward, at the end: mean (range), seeds"
    return tables.Table(title, ["method", *ends, "all: mean [95 %]", "control steps"], rows)


def _over_all(ends: Sequence[Curve], y: str) -> str:
    """Writes the mean over mazes, each of the same weight, and its bootstrapped interval."""
    _, scale, digits = _UNITS[y]
    values = [scale * end[:, 1] for end in ends]
    mean = f"{np.mean([each.mean() for each in values]):.{digits}f}"
    # A seed that is alone in its maze says nothing of others.
    if min(map(len, values)) == 1:
        return mean
    low, high = (f"{x:.{digits}f}" for x in statistics.bootstrap(values))
    return f"{mean} [{low}, {high}]"


def _budgets(label: str, ends: dict[str, Curve]) -> str:
    """Writes how many control steps a method learned for, by maze where they differ."""
    if label == paper.RAND_H:
        return "none"
    mazes_of: dict[str, list[str]] = {}
    for maze, end in ends.items():
        mazes_of.setdefault(_steps(end[:, 0].tolist()), []).append(maze)
    if len(mazes_of) == 1:
        return next(iter(mazes_of))
    return "; ".join(f"{steps} in {', '.join(names)}" for steps, names in mazes_of.items())


def _where_ours_is_reached(all_ends: dict[tuple[base.Reward, str], Ends]) -> tables.Table:
    """Lists the tasks in which another method's best seed is as good as our worst, walking."""
    rows = []
    for (reward, y), ends in all_ends.items():
        for maze, by_label in ends.items():
            if _OURS not in by_label:
                continue

            # By the seeds that speak most against us, as three seeds say little of a mean.
            worst = by_label[_OURS][:, 1].min()
            reached = [
                f"{label} {_spread(end, y)}"
                for label, end in by_label.items()
                if not label.startswith("ours") and end[:, 1].max() >= worst
            ]
            if reached:
                task = [cached_runs.task(maze, reward), _UNITS[y][0], _spread(by_label[_OURS], y)]
                rows.append([*task, "; ".join(reached)])
    title = "Where ours isn't clearly better: its worst seed is no better than another's best"
    return tables.Table(title, ["task", "measure", _OURS, "others"], rows)


def _spread(end: Curve | None, y: str) -> str:
    """Writes mean, range and number of the last values of several seeds."""
    if end is None:
        return "-"
    _, scale, digits = _UNITS[y]
    values = scale * end[:, 1]
    mean, low, high = (f"{x:.{digits}f}" for x in (values.mean(), values.min(), values.max()))
    return f"{mean} ({low} to {high}), {len(end)}"


def _steps(ends: Sequence[float]) -> str:
    """Writes how many control steps were spent, which differ by rows of metrics."""
    low, high = (f"{round(end):,}" for end in (min(ends), max(ends)))
    return high if low == high else f"{low} to {high}"


def _pictures(
    task: Task, long: Callable[[str], list[pathlib.Path]], out: pathlib.Path
) -> list[page.Picture]:
    """Draws a task against both axes."""
    budget = _steps([float(x) for end in task.ends("success").values() for x in end[:, 0]])
    out.mkdir(parents=True, exist_ok=True)
    pictures = []
    for y, (axis, read) in itertools.product(_MEASURES[task.reward], AXES.items()):
        drawn = task.curves(y, read)
        if files := long(f"best-{task.name}"):
            drawn[LONG] = [read(file, f"eval/{y}") for file in files]

        label, scale, _ = _UNITS[y]
        path = out / f"baselines-{task.name}-{y}-{axis.replace(' ', '-')}.png"
        draw = functools.partial(
            curves.save_spread,
            path,
            drawn,
            x_label=f"{axis} (budget: {budget} control steps)",
            y_label=label,
            y_scale=scale,
            has_log_x=True,
            labels=_STYLES,
        )
        if figures.attempt(path, draw):
            how = "mean and range over seeds"
            text = f"{task.maze}, {task.reward} reward: {y} against {axis}, {how}."
            pictures.append(page.Picture(path, text))
    return pictures


def _is_evaluated(file: pathlib.Path, name: str) -> bool:
    """Returns whether a run has been evaluated; its file may be empty until then."""
    if f"{name}/success" not in curves.columns(file):
        return False
    return any(row[f"{name}/success"] for row in curves.rows(file))


def by_steps(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against control steps."""
    if "num_decisions" not in curves.columns(file):
        return curves.read(file, "step", y)
    return curves.read(file, "num_decisions", y) * [robots.load("ant").steps_per_subgoal, 1.0]


def by_episodes(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against the episodes that had ended, from the first one on."""
    if "episodes" in curves.columns(file):
        x = "step"
        done, ended = curves.read(file, x, "episodes").T
    else:
        # Shipped metrics: what was decided since the last row, over the mean length of what ended.
        x = "num_decisions"
        done, length = curves.read(file, x, "decisions").T
        ended = np.diff(done, prepend=0.0) / length

    curve = curves.read(file, x, y)
    curve[:, 0] = np.interp(curve[:, 0], done, np.cumsum(ended))
    return curve[curve[:, 0] > 0.0]


AXES: dict[str, Read] = {"episodes": by_episodes, "control steps": by_steps}
