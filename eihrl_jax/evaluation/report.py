"""Files of an evaluation: numbers, tables and pictures in one folder.

    eval.json                    see `results.Evaluation`
    tables.md                    the tables of the terminal
    episodes.csv                 one row per episode
    <system>-<maze>-heatmap.png  visited positions (paper, Figure 7)
    <system>-heatmaps.png        all mazes on one scale
    <system>-<maze>.gif          an episode

A system is called by its robot, movement and high level, e.g. `ant-full-random`.
"""

import contextlib
import csv
import os
import pathlib
import re
from collections.abc import Iterator, Mapping

import numpy as np

from eihrl_jax import base, mazes
from eihrl_jax.evaluation import animation, curves, heatmap, results, rollouts, tables
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.training import run_folder

_EPISODE_COLUMNS = (
    *("robot", "movement", "high", "low", "maze", "seed", "episode", "achieved", "goals"),
    *("return", "decisions", "fell", "outcome"),
)

_HIGH_CURVES = {"workers in training": "success", "evaluation": "eval/success"}


@contextlib.contextmanager
def reserved(out: pathlib.Path) -> Iterator[None]:
    """Makes a folder and keeps other processes out of it, so that nothing can be overwritten.

    A folder in which nothing has been written by the end is removed again.

    Raises:
      base.UserError: `out` is a file, or a folder with something in it, or being filled.
    """
    _check_empty(out)
    out.mkdir(parents=True, exist_ok=True)
    lock = run_folder.take_lock(out)
    try:
        _check_empty(out)  # another may have filled it since
        yield
    finally:
        (out / run_folder.LOCK).unlink()
        os.close(lock)
        if not any(out.iterdir()):
            out.rmdir()


def _check_empty(out: pathlib.Path) -> None:
    if run_folder.holds_something(out):
        raise base.UserError(f"out = {out} is not empty; name a new or empty folder")


def file_name(system: results.System) -> str:
    """Returns how files call a system."""
    words = (system.robot, system.movement, pathlib.PurePath(system.high).name)
    return re.sub(r"[^\w.-]+", "_", "-".join(words))


def title(system: results.System, maze: str) -> str:
    """Returns how pictures call a system in a maze."""
    name = tables.TABLE1_MAZES.get(maze, maze)
    moves = "walking" if system.movement == "full" else "oracle movement"
    return f"{name} · {system.robot}, {moves}"


def write_results(out: pathlib.Path, evaluation: results.Evaluation) -> None:
    """Writes `eval.json` and `tables.md`."""
    results.save(out / "eval.json", evaluation)
    (out / "tables.md").write_text(tables.markdown(evaluation.cells))


def write_episodes(
    out: pathlib.Path,
    system: results.System,
    found: dict[str, rollouts.Rollout],
    chosen: dict[str, mazes.Maze],
) -> None:
    """Appends the episodes of one system to `episodes.csv`."""
    path = out / "episodes.csv"
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(_EPISODE_COLUMNS)
        for maze, rollout in found.items():
            episodes, num_goals = rollout.episodes, int(chosen[maze].num_goals)
            outcomes = episodes.outcomes(num_goals)
            numbers = {seed: 0 for seed in episodes.seed.tolist()}
            for i, outcome in enumerate(outcomes):
                seed = int(episodes.seed[i])
                row = [system.robot, system.movement, system.high, system.low or ""]
                row += [maze, seed, numbers[seed], int(episodes.achieved[i]), num_goals]
                row += [float(episodes.returns[i]), int(episodes.decisions[i])]
                writer.writerow([*row, int(episodes.has_fallen[i]), outcome])
                numbers[seed] += 1


def draw_heatmaps(
    out: pathlib.Path,
    system: results.System,
    found: dict[str, rollouts.Rollout],
    chosen: dict[str, mazes.Maze],
) -> None:
    """Draws where one system has been: one picture per maze, and one of all."""
    visits = [
        heatmap.Visits(title(system, name), chosen[name], rollout.share)
        for name, rollout in found.items()
    ]
    for name, item in zip(found, visits, strict=True):
        heatmap.save(out / f"{file_name(system)}-{name}-heatmap.png", item)
    if len(visits) > 1:
        heatmap.save_together(out / f"{file_name(system)}-heatmaps.png", visits)


def animate(
    out: pathlib.Path,
    system: results.System,
    robot: robot_lib.Robot,
    rollout: rollouts.Rollout,
    maze: str,
) -> None:
    """Animates a typical episode of one system in one maze."""
    capsules = kinematics.capsules(scene.build(robot))
    animation.save(
        out / f"{file_name(system)}-{maze}.gif",
        typical(rollout),
        capsules,
        title=tables.TABLE1_MAZES.get(maze, maze),
        reach=robot.reach,
    )


def typical(rollout: rollouts.Rollout) -> animation.Recording:
    """Returns the recorded episode of median length among those that achieved most."""
    achieved = rollout.episodes.achieved[: len(rollout.recordings)]
    best = np.flatnonzero(achieved == achieved.max())
    lengths = [int(rollout.recordings[i].decision[-1]) for i in best]
    return rollout.recordings[best[np.argsort(lengths, kind="stable")[len(best) // 2]]]


def draw_learning_curve(
    run: pathlib.Path,
    columns: Mapping[str, str] = _HIGH_CURVES,
    *,
    x: str = "num_decisions",
    x_label: str = "decisions",
    y_label: str = "success, %",
) -> pathlib.Path:
    """Draws success while a run learned into its folder, of `train_high` unless told otherwise.

    Args:
      run: its folder.
      columns: columns of its metrics, by label.
      x: the column against which they are drawn.
      x_label: what that is.
      y_label: what they are.

    Returns:
      The picture's path.

    Raises:
      base.UserError: the folder has no such metrics.
    """
    metrics = run / "metrics.csv"
    path = run / "learning_curve.png"
    curves.save(
        path,
        {label: curves.read(metrics, x, column) for label, column in columns.items()},
        x_label=x_label,
        y_label=y_label,
        y_scale=100.0,
        y_range=(0.0, 100.0),
    )
    return path
