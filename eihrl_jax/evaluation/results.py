"""Results of an evaluation as plain data: one `Cell` per maze and agent, and `eval.json`.

`eval.json` holds the fields of `Evaluation`. Rates lie in [0, 1]; a number that does not exist is
null.
"""

import collections
import dataclasses
import hashlib
import json
import pathlib
import re
from typing import Any

import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int

from eihrl_jax import base
from eihrl_jax.config import codec
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.evaluation import statistics
from eihrl_jax.storage import reading, writing

FORMAT = 2
"""Of `eval.json`. Files of format 1, which call agents systems and uniform directions random, are
read too."""

_NO_CHECKSUM = '"checksum": null'

_MAX_NAME = 100
"""Bytes of an agent's or a maze's part of a file's name; a whole name has 255 at most."""

OUTCOMES = ("solved", "fallen", "unstable", "late")
"""How an episode ends: all goals achieved; else the robot had fallen; else its simulation broke
down; else it was upright when the last decision was spent."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Agent:
    """What is evaluated: a high level, and what carries out its subgoals.

    Attributes:
      robot: name of the robot.
      movement: "oracle", where the simulator moves the torso, or "full", the full hierarchy.
      high: label of the high level, "uniform" for uniform directions; or of a baseline.
      low: label of the low level; None with oracle movement and for a baseline.
    """

    robot: str
    movement: str
    high: str
    low: str | None

    @property
    def file_name(self) -> str:
        """Name of the agent in files' names, e.g. `ant-full-uniform`."""
        # Of a path the last part alone, and nothing that a file system could object to.
        words = (self.robot, self.movement, pathlib.PurePath(self.high).name)
        return writing.short(re.sub(r"[^\w.-]+", "_", "-".join(words)), _MAX_NAME)

    def file_name_in(self, maze: str) -> str:
        """Returns what the names of its files of one maze begin with."""
        return f"{self.file_name}-{writing.short(maze, _MAX_NAME)}"


class Episodes(struct.PyTreeNode):
    """Numbers of E finished episodes, on the host.

    Attributes:
      visited: bool [E, G], which goals were reached, G at least as many as there are.
      end_xy: float [E, 2], where the torso was at the end, units.
      returns: float [E], undiscounted return, unitless.
      decisions: int [E], decisions used.
      has_fallen: bool [E], whether the robot ever fell.
      is_unstable: bool [E], whether its simulation broke down (NaN).
      seed: int [E], evaluation seed.
      shortest: int [E], moves of the shortest tour of all goals; None where nobody has counted.
    """

    visited: Bool[np.ndarray, "E G"]
    end_xy: Float[np.ndarray, "E 2"]
    returns: Float[np.ndarray, " E"]
    decisions: Int[np.ndarray, " E"]
    has_fallen: Bool[np.ndarray, " E"]
    is_unstable: Bool[np.ndarray, " E"]
    seed: Int[np.ndarray, " E"]
    shortest: Int[np.ndarray, " E"] | None = None

    @property
    def achieved(self) -> Int[np.ndarray, " E"]:
        """Number of goals reached, int [E]."""
        return self.visited.sum(-1)

    def outcomes(self, num_goals: int) -> list[str]:
        """Names each episode's outcome, one of `OUTCOMES`."""
        # The first that holds counts: who fell after the last goal has solved the maze.
        conditions = [self.achieved == num_goals, self.has_fallen, self.is_unstable]
        return np.select(conditions, OUTCOMES[:-1], default=OUTCOMES[-1]).tolist()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Outcomes:
    """Number of episodes by how they ended, see `OUTCOMES`."""

    solved: int
    fallen: int
    unstable: int
    late: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """The result of one agent in one maze.

    Attributes:
      maze: name of the maze.
      agent: what was evaluated.
      seeds: evaluation seeds.
      num_episodes: episodes over all seeds.
      num_goals: goals per episode.
      num_decisions: time limit in decisions.
      success: achieved goals / total goals, with its 95 % interval.
      seed_rates: success rate of each seed.
      return_mean: mean undiscounted return.
      decisions_mean: mean number of decisions used.
      decisions_solved: the same over solved episodes; None where there is none.
      path_ratio: decisions over the moves of the shortest tour, mean over solved episodes; None
        where there is none, or where episodes go on when they are solved.
      num_falls: episodes in which the robot fell.
      outcomes: number of episodes by outcome.
      goal_rates: share of the episodes that reached each goal, from goal 1 on; () in files from
        before these were counted.
    """

    maze: str
    agent: Agent
    seeds: tuple[int, ...]
    num_episodes: int
    num_goals: int
    num_decisions: int
    success: statistics.Success
    seed_rates: tuple[float, ...]
    return_mean: float
    decisions_mean: float
    decisions_solved: float | None
    path_ratio: float | None = None
    num_falls: int
    outcomes: Outcomes
    goal_rates: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Some agents in some mazes.

    Attributes:
      format: of the file, `FORMAT`.
      checksum: SHA-256 of the file with null in its place; None in files from before there was one.
      about: how it was made, plain JSON.
      cells: the results.
    """

    format: int = FORMAT
    checksum: str | None = None
    about: Any = None
    cells: tuple[Cell, ...]


def summarise(
    maze: str, agent: Agent, episodes: Episodes, *, num_goals: int, num_decisions: int
) -> Cell:
    """Summarises the episodes of one agent in one maze."""
    # Seeds in the order in which they were asked for.
    achieved, seeds = episodes.achieved, tuple(dict.fromkeys(episodes.seed.tolist()))
    counts = collections.Counter(episodes.outcomes(num_goals))
    is_solved = achieved == num_goals
    solved, ratio = episodes.decisions[is_solved], None
    if episodes.shortest is not None and len(solved):
        # Who starts in a goal needs one decision to be paid.
        ratio = float((solved / np.maximum(episodes.shortest[is_solved], 1)).mean())

    return Cell(
        maze=maze,
        agent=agent,
        seeds=seeds,
        num_episodes=len(achieved),
        num_goals=num_goals,
        num_decisions=num_decisions,
        success=statistics.success(achieved, num_goals),
        seed_rates=tuple(float(achieved[episodes.seed == s].mean() / num_goals) for s in seeds),
        return_mean=float(episodes.returns.mean()),
        decisions_mean=float(episodes.decisions.mean()),
        decisions_solved=float(solved.mean()) if len(solved) else None,
        path_ratio=ratio,
        num_falls=int(episodes.has_fallen.sum()),
        outcomes=Outcomes(**{name: counts[name] for name in OUTCOMES}),
        goal_rates=tuple(episodes.visited[:, :num_goals].mean(0).tolist()),
    )


def save(path: pathlib.Path, evaluation: Evaluation) -> None:
    """Writes `eval.json`, with its checksum."""
    text = codec.to_json(dataclasses.replace(evaluation, checksum=None))
    writing.write_text(path, text.replace(_NO_CHECKSUM, f'"checksum": "{_sha256(text)}"', 1))


def load(path: pathlib.Path) -> Evaluation:
    """Reads an `eval.json`.

    Raises:
      base.UserError: the file can't be read, is damaged or is no `eval.json` of a known format.
    """
    try:
        text = reading.read_text(path)
    except OSError as error:
        raise base.UserError(f"{path} can't be read: {error}") from None
    try:
        evaluation = codec.from_json(Evaluation, _updated(text))
    except ValueError as error:
        raise base.UserError(f"{path} is no eval.json: {error}") from None

    # Another format may have the same fields and mean something else by them.
    if evaluation.format != FORMAT:
        raise base.UserError(f"{path}: eval.json has format {evaluation.format}, expected {FORMAT}")
    # Of the text: another version may write the same numbers in another way.
    checksum = evaluation.checksum
    without = text.replace(f'"checksum": "{checksum}"', _NO_CHECKSUM, 1)
    if checksum is not None and checksum != _sha256(without):
        raise base.UserError(f"{path} is damaged: it isn't as it was written")
    return dataclasses.replace(evaluation, checksum=None)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()


def _updated(text: str) -> str:
    """Returns a file of format 1 as one of today's format, any other as it is."""
    content = reading.parse_json(text, "it")
    if not isinstance(content, dict) or content.get("format") != 1:
        return text
    return json.dumps(json.loads(text, object_hook=_renamed) | {"format": FORMAT})


def _renamed(item: dict[str, Any]) -> dict[str, Any]:
    """Returns a JSON object of format 1, a cell, agent or config, in today's words."""
    if isinstance(item.get("system"), dict):  # the versions have a system too: the computer's
        item["agent"] = item.pop("system")
    if item.get("high") == "random":
        item["high"] = evaluate_config.UNIFORM
    elif isinstance(item.get("high"), list):
        item["high"] = [evaluate_config.UNIFORM if h == "random" else h for h in item["high"]]
    return item
