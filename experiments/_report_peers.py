"""Learning of the peers beside ours for `experiments.report` (paper, Figures 5 and 6)."""

import csv
import itertools
import pathlib
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from eihrl_jax import base, robots
from eihrl_jax.evaluation import curves, page

MAZES = ("random", "u", "s", "spiral")
METHODS = {"droq": "flat DroQ", "higl": "HIGL", "hrac": "HRAC", "hiro": "HIRO", "hess": "HESS"}
"""How the pictures call the methods of `train_baseline`."""

OURS = "ours, oracle"

Curve = Float[np.ndarray, "N 2"]


def section(
    ours: Callable[[str], list[pathlib.Path]], peers: pathlib.Path | None, out: pathlib.Path
) -> page.Section:
    """Draws success, or with dense reward its mean per step, against episodes and control steps.

    Args:
      ours: finds the metrics of our high levels trained alike, e.g. "best-u" or "best-u-dense".
      peers: folder of runs of `train_baseline`, `<method>-<maze>[-dense]-<seed>` each; None: no
        picture.
      out: folder of the pictures.

    Raises:
      base.UserError: `peers` holds no such run.
    """
    pictures = []
    for maze, reward in itertools.product(MAZES, ("sparse", "dense")):
        task = maze if reward == "sparse" else f"{maze}-dense"
        y, label, scale = ("success", "success, %", 100.0)
        if reward == "dense":
            y, label, scale = ("reward", "reward per step", 1.0)
        runs = {} if peers is None else _runs(peers, task)
        if not runs:
            continue
        runs |= {OURS: high} if (high := ours(f"best-{task}")) else {}
        for axis, read in _AXES.items():
            drawn = {name: [read(file, f"eval/{y}") for file in runs[name]] for name in runs}
            path = out / f"peers-{task}-{axis.replace(' ', '-')}.png"
            out.mkdir(parents=True, exist_ok=True)
            curves.save_spread(
                path, drawn, x_label=axis, y_label=label, y_scale=scale, has_log_x=True
            )
            text = f"{maze}, {reward} reward, against {axis}: mean and range over seeds."
            pictures.append(page.Picture(path, text))
    if peers is not None and not pictures:
        raise base.UserError(f"peers = {peers} holds no <method>-<maze>-<seed>")
    return page.Section(
        title="Learning beside the peers (Figures 5 and 6)",
        text="Peers walk while they learn, and are evaluated without exploration. Ours is moved by "
        "the oracle: a decision counts as the ant's 25 control steps, and the low level that walks "
        "afterwards was trained before.",
        pictures=pictures,
    )


def _runs(folder: pathlib.Path, task: str) -> dict[str, list[pathlib.Path]]:
    """Finds the metrics of each method in a task."""
    found = {
        label: sorted(folder.glob(f"{method}-{task}-[0-9]*/metrics.csv"))
        for method, label in METHODS.items()
    }
    return {label: files for label, files in found.items() if files}


def _by_steps(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against control steps."""
    if not _has(file, "num_decisions"):
        return curves.read(file, "step", y)
    return curves.read(file, "num_decisions", y) * [robots.load("ant").steps_per_subgoal, 1.0]


def _by_episodes(file: pathlib.Path, y: str) -> Curve:
    """Reads a curve against the episodes that had ended."""
    with file.open(newline="") as text:
        rows = list(csv.DictReader(text))
    if _has(file, "num_decisions"):
        # Ours: what was decided since the last row, over the mean length of what ended.
        decided = np.diff([float(row["num_decisions"]) for row in rows], prepend=0.0)
        ended = decided / [float(row["decisions"]) for row in rows]
    else:
        ended = np.array([float(row["episodes"]) for row in rows])
    points = zip(np.cumsum(ended), (row[y] for row in rows), strict=True)
    return np.array([(x, float(value)) for x, value in points if value])


def _has(file: pathlib.Path, column: str) -> bool:
    with file.open() as text:
        return column in text.readline().strip().split(",")


_AXES: dict[str, Callable[[pathlib.Path, str], Curve]] = {
    "episodes": _by_episodes,
    "control steps": _by_steps,
}
