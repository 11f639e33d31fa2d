"""Files of an evaluation: numbers, tables and pictures in one folder.

    eval.json                    see `results.Evaluation`
    tables.md                    the tables of the terminal
    episodes.csv                 one row per episode
    <agent>-<maze>-heatmap.png  visited positions (paper, Figure 7)
    <agent>-heatmaps.png        all mazes on one scale
    <agent>-ends.png            where episodes ended that failed, if any did
    <agent>-<maze>.gif          an episode, or .mp4

An agent's name consists of its robot, movement and high level, e.g. `ant-full-uniform`. Numbers are
written before pictures, and a picture that can't be drawn costs nothing else.
"""

import collections
import csv
import dataclasses
import functools
import io
import itertools
import json
import pathlib
from collections.abc import Iterator

import numpy as np

from eihrl_jax.config import changes, codec
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.drawing import animation, figures, film, heatmap
from eihrl_jax.drawing import endings as endings_lib
from eihrl_jax.evaluation import evaluate as evaluation_lib
from eihrl_jax.evaluation import recording, results, rollouts, tables
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import folders, versions
from eihrl_jax.storage import writing

_MAX_LABEL = 40  # letters, of a name above a picture

_EPISODE_COLUMNS = (
    *("robot", "movement", "high", "low", "maze", "seed", "episode", "achieved", "goals"),
    *("return", "decisions", "fell", "outcome", "shortest", "end_x", "end_y"),
)


def evaluate(options: evaluate_config.EvaluateConfig) -> results.Evaluation:
    """Runs an evaluation and fills its folder.

    Args:
      options: what is to be evaluated.

    Returns:
      What `eval.json` holds; `tables` turns its cells into tables.

    Raises:
      base.UserError: the folder isn't free; see also `evaluation.evaluate.run`.

    >>> options = evaluate_config.EvaluateConfig(
    ...     mazes=("u",), high=("best-u-0",), movement=("oracle",), episodes=20, animate="none"
    ... )
    >>> (cell,) = evaluate(options).cells
    1 agent in 1 maze: 20 episodes of each agent, at most 480 decisions
    ant, oracle movement, best-u-0: compiling episodes ...
    >>> cell.success.rate > 0.8
    True
    """
    if options.quick:
        # What was asked for stays; what equals its default counts as not asked for.
        default = evaluate_config.EvaluateConfig()
        first_look = {"movement": ("full",), "episodes": 20, "heatmaps": False}
        asked = {name for name in first_look if getattr(options, name) != getattr(default, name)}
        changed = {name: value for name, value in first_look.items() if name not in asked}
        options = changes.apply(options, changed)
    if options.animate != "none":
        film.check(pathlib.Path(f"film.{options.format}"))  # before hours are spent
    task = codec.to_json(dataclasses.replace(options, out=pathlib.Path()))
    with folders.reserved(options.out, task):
        numbers = _Numbers(options)
        animated: set[results.Agent] = set()

        def animate_once(evaluated: evaluation_lib.Evaluated) -> None:
            if evaluated.agent not in animated:
                animated.add(evaluated.agent)
                _animate(evaluated, options)

        for evaluated in evaluation_lib.run(options, animate_once):
            numbers.add(evaluated)
            if options.heatmaps:
                _draw_heatmaps(options.out, evaluated)
                _draw_endings(options.out, evaluated)
            animate_once(evaluated)
    return numbers.evaluation


class _Numbers:
    """The numbers of an evaluation, in files that are whole after every agent."""

    def __init__(self, options: evaluate_config.EvaluateConfig):
        """Begins without any."""
        self._out = options.out
        self._about = {
            "config": json.loads(codec.to_json(options)),
            "versions": versions.describe(),
            "seconds": {},
        }
        self._episodes = io.StringIO()
        csv.writer(self._episodes).writerow(_EPISODE_COLUMNS)
        self.evaluation = results.Evaluation(cells=())

    def add(self, evaluated: evaluation_lib.Evaluated) -> None:
        """Adds what one agent has done, and writes all that there is."""
        self._about["seconds"][evaluated.agent.file_name] = round(evaluated.seconds, 2)
        cells = (*self.evaluation.cells, *evaluated.cells())
        self.evaluation = results.Evaluation(about=self._about, cells=cells)
        _add_episodes(self._episodes, evaluated)

        writing.write_text(self._out / "episodes.csv", self._episodes.getvalue())
        writing.write_text(self._out / "tables.md", tables.markdown(cells))
        results.save(self._out / "eval.json", self.evaluation)


def _animate(evaluated: evaluation_lib.Evaluated, options: evaluate_config.EvaluateConfig) -> None:
    """Animates what the options ask for of one agent."""
    # "one": the last agent's first maze, a single picture for the whole evaluation.
    names = [name for name, rollout in evaluated.rollouts.items() if rollout.recordings]
    num = {"one": int(evaluated.is_last), "none": 0}.get(options.animate, len(names))
    for name in names[:num]:
        chosen, ending = typical(evaluated.rollouts[name]), ""
        if options.animate == "failed":
            chosen, ending = _failed(evaluated, name)
        if chosen is not None:
            file = f"{evaluated.agent.file_name_in(name)}{ending}.{options.format}"
            parts = chosen, evaluated.robot, _label(name), options.camera
            figures.attempt(
                options.out / file, functools.partial(animate, options.out / file, *parts)
            )


def _add_episodes(file: io.StringIO, evaluated: evaluation_lib.Evaluated) -> None:
    """Adds the episodes of one agent to a table."""
    agent, writer = evaluated.agent, csv.writer(file)
    for maze, rollout in evaluated.rollouts.items():
        episodes, num_goals = rollout.episodes, int(evaluated.mazes[maze].num_goals)
        columns = (
            *(episodes.seed.tolist(), episodes.achieved.tolist(), episodes.returns.tolist()),
            *(episodes.decisions.tolist(), episodes.has_fallen.tolist()),
            episodes.outcomes(num_goals),
            [""] * len(episodes.seed) if episodes.shortest is None else episodes.shortest,
            episodes.end_xy.astype(float).round(2).tolist(),
        )

        numbers = collections.defaultdict[int, Iterator[int]](itertools.count)  # by seed
        for seed, achieved, paid, decisions, fell, *rest in zip(*columns, strict=True):
            row = [agent.robot, agent.movement, agent.high, agent.low or "", maze, seed]
            row += [next(numbers[seed]), achieved, num_goals, paid, decisions, int(fell)]
            outcome, moves, end_xy = rest
            writer.writerow([*row, outcome, moves, *end_xy])


def _draw_heatmaps(out: pathlib.Path, evaluated: evaluation_lib.Evaluated) -> None:
    """Draws where one agent has been: one picture per maze, and one of all."""
    agent = evaluated.agent
    who = f"{agent.robot}, {tables.MOVEMENT_NAMES[agent.movement]}"
    # Drawn twice: each alone, and all of them on one scale.
    visits = {
        name: heatmap.Visits(f"{_label(name)} · {who}", evaluated.mazes[name], rollout.share)
        for name, rollout in evaluated.rollouts.items()
    }

    for name, item in visits.items():
        path = out / f"{agent.file_name_in(name)}-heatmap.png"
        figures.attempt(path, functools.partial(heatmap.save, path, item))
    if len(visits) > 1:
        path, every = out / f"{agent.file_name}-heatmaps.png", list(visits.values())
        figures.attempt(path, functools.partial(heatmap.save_together, path, every))


def _draw_endings(out: pathlib.Path, evaluated: evaluation_lib.Evaluated) -> None:
    """Draws where the episodes of one agent ended that failed, if any did."""
    endings = [
        endings_lib.Endings(
            title=_label(name),
            maze=evaluated.mazes[name],
            outcomes=rollout.episodes.outcomes(int(evaluated.mazes[name].num_goals)),
            end_xy=rollout.episodes.end_xy,
        )
        for name, rollout in evaluated.rollouts.items()
    ]
    if any(outcome != "solved" for item in endings for outcome in item.outcomes):
        path = out / f"{evaluated.agent.file_name}-ends.png"
        figures.attempt(path, functools.partial(endings_lib.save, path, endings))


def _failed(
    evaluated: evaluation_lib.Evaluated, maze: str
) -> tuple[recording.Recording | None, str]:
    """Returns a maze's first episode that failed and its file's ending, or says there is none."""
    rollout = evaluated.rollouts[maze]
    outcomes = rollout.episodes.outcomes(int(evaluated.mazes[maze].num_goals))
    # The first episodes alone are recorded.
    for recorded, outcome in zip(rollout.recordings, outcomes, strict=False):
        if outcome != "solved":
            return recorded, f"-{outcome}"
    num = len(rollout.recordings)
    print(f"{evaluated.agent.file_name}, {maze}: none of {num} recorded episodes failed")
    return None, ""


def animate(
    path: pathlib.Path,
    recorded: recording.Recording,
    robot: robot_lib.Robot,
    title: str,
    camera: evaluate_config.Camera = "auto",
) -> None:
    """Animates an episode of a robot.

    Args:
      path: where the animation goes, a GIF or MP4.
      recorded: the episode.
      robot: whose it is.
      title: what is shown.
      camera: whether it follows the robot.

    Raises:
      base.UserError: the name has another ending, or MP4 can't be written here.
    """
    animation.save(
        path,
        recorded,
        kinematics.capsules(scene.build(robot), robot.units_per_metre),
        title=title,
        reach=robot.reach * robot.units_per_metre,
        camera=camera,
    )


def _label(maze: str) -> str:
    """Returns the name of a maze in pictures, the paper's where it has one."""
    label = tables.TABLE1_MAZES.get(maze, maze)
    return label if len(label) <= _MAX_LABEL else f"{label[: _MAX_LABEL - 1]}…"


def typical(rollout: rollouts.Rollout) -> recording.Recording:
    """Returns the recorded episode of median length among those that achieved most."""
    # The first episodes alone are recorded.
    achieved = rollout.episodes.achieved[: len(rollout.recordings)]
    best = np.flatnonzero(achieved == achieved.max())
    # Ties in the order in which they were run, so that every machine animates the same one.
    lengths = [int(rollout.recordings[i].decision[-1]) for i in best]
    return rollout.recordings[best[np.argsort(lengths, kind="stable")[len(best) // 2]]]
