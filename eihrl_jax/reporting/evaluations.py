"""Files of an evaluation: numbers, tables and pictures in one folder.

    eval.json                    see `results.Evaluation`
    tables.md                    the tables of the terminal
    episodes.csv                 one row per episode
    <agent>-<maze>-heatmap.png  visited positions (paper, Figure 7)
    <agent>-heatmaps.png        all mazes on one scale
    <agent>-<maze>.gif          an episode

An agent is called by its robot, movement and high level, e.g. `ant-full-uniform`.
"""

import csv
import json
import pathlib

import numpy as np

from eihrl_jax import mazes
from eihrl_jax.config import codec
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.drawing import animation, heatmap
from eihrl_jax.evaluation import evaluate as evaluation_lib
from eihrl_jax.evaluation import recording, results, rollouts, tables
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import folders, versions

_EPISODE_COLUMNS = (
    *("robot", "movement", "high", "low", "maze", "seed", "episode", "achieved", "goals"),
    *("return", "decisions", "fell", "outcome"),
)


def evaluate(options: evaluate_config.EvaluateConfig) -> results.Evaluation:
    """Runs an evaluation and fills its folder.

    Args:
      options: what is to be evaluated.

    Returns:
      What `eval.json` holds; `tables` turns its cells into tables.

    Raises:
      base.UserError: the folder isn't free; see also `evaluation.evaluate.run`.
    """
    with folders.reserved(options.out):
        cells: list[results.Cell] = []
        seconds: dict[str, float] = {}
        for evaluated in evaluation_lib.run(options):
            cells += evaluated.cells()
            seconds[evaluated.agent.file_name] = round(evaluated.seconds, 2)
            _write(evaluated, options)

        about = {
            "config": json.loads(codec.to_json(options)),
            "versions": versions.describe(),
            "seconds": seconds,
        }
        evaluation = results.Evaluation(about=about, cells=tuple(cells))
        write_results(options.out, evaluation)
    return evaluation


def _write(evaluated: evaluation_lib.Evaluated, options: evaluate_config.EvaluateConfig) -> None:
    """Writes the episodes of one agent, and draws what the options ask for."""
    agent, found = evaluated.agent, evaluated.rollouts
    write_episodes(options.out, agent, found, evaluated.mazes)
    if options.heatmaps:
        draw_heatmaps(options.out, agent, found, evaluated.mazes)
    if options.animate == "all" or (options.animate == "one" and evaluated.is_last):
        names = list(found) if options.animate == "all" else list(found)[:1]
        for name in names:
            animate(options.out, agent, evaluated.robot, found[name], name)


def title(agent: results.Agent, maze: str) -> str:
    """Returns how pictures call an agent in a maze."""
    name = tables.TABLE1_MAZES.get(maze, maze)
    moves = "walking" if agent.movement == "full" else "oracle movement"
    return f"{name} · {agent.robot}, {moves}"


def write_results(out: pathlib.Path, evaluation: results.Evaluation) -> None:
    """Writes `eval.json` and `tables.md`."""
    results.save(out / "eval.json", evaluation)
    (out / "tables.md").write_text(tables.markdown(evaluation.cells))


def write_episodes(
    out: pathlib.Path,
    agent: results.Agent,
    found: dict[str, rollouts.Rollout],
    chosen: dict[str, mazes.Maze],
) -> None:
    """Appends the episodes of one agent to `episodes.csv`."""
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
                row = [agent.robot, agent.movement, agent.high, agent.low or ""]
                row += [maze, seed, numbers[seed], int(episodes.achieved[i]), num_goals]
                row += [float(episodes.returns[i]), int(episodes.decisions[i])]
                writer.writerow([*row, int(episodes.has_fallen[i]), outcome])
                numbers[seed] += 1


def draw_heatmaps(
    out: pathlib.Path,
    agent: results.Agent,
    found: dict[str, rollouts.Rollout],
    chosen: dict[str, mazes.Maze],
) -> None:
    """Draws where one agent has been: one picture per maze, and one of all."""
    visits = [
        heatmap.Visits(title(agent, name), chosen[name], rollout.share)
        for name, rollout in found.items()
    ]
    for name, item in zip(found, visits, strict=True):
        heatmap.save(out / f"{agent.file_name}-{name}-heatmap.png", item)
    if len(visits) > 1:
        heatmap.save_together(out / f"{agent.file_name}-heatmaps.png", visits)


def animate(
    out: pathlib.Path,
    agent: results.Agent,
    robot: robot_lib.Robot,
    rollout: rollouts.Rollout,
    maze: str,
) -> None:
    """Animates a typical episode of one agent in one maze."""
    capsules = kinematics.capsules(scene.build(robot))
    animation.save(
        out / f"{agent.file_name}-{maze}.gif",
        typical(rollout),
        capsules,
        title=tables.TABLE1_MAZES.get(maze, maze),
        reach=robot.reach,
    )


def typical(rollout: rollouts.Rollout) -> recording.Recording:
    """Returns the recorded episode of median length among those that achieved most."""
    achieved = rollout.episodes.achieved[: len(rollout.recordings)]
    best = np.flatnonzero(achieved == achieved.max())
    lengths = [int(rollout.recordings[i].decision[-1]) for i in best]
    return rollout.recordings[best[np.argsort(lengths, kind="stable")[len(best) // 2]]]
