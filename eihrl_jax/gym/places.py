"""Mazes on the host, and the starts and goals that `reset` may be given."""

import functools
import os
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Int

from eihrl_jax import base, mazes
from eihrl_jax.config import checks, limits
from eihrl_jax.envs import task
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import paths
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines
from eihrl_jax.robots import robot as robot_lib

START, GOAL, MASK = "start_cell", "goal_cell", "reset_mask"
"""Options of `reset`."""

_OWN, _MOVED = 0, 1
"""Rows of `HostMaze.stacked`: the maze with its own goals, and without any, for a given goal."""

Options: TypeAlias = dict[str, Any]
"""Gymnasium's options of `reset`, whose values may be anything."""


class Places(struct.PyTreeNode):
    """The places of N episodes.

    Attributes:
      maze: int32 [N], rows of `HostMaze.stacked`.
      place: where in it.
    """

    maze: Int[Array, " N"]
    place: task.Place


class HostMaze:
    """A maze as NumPy arrays, equal to another one of the same content.

    Until it is `stacked` nothing of JAX is started, so that a process may still be forked.
    """

    def __init__(self, maze: maze_lib.Maze):
        """Takes a maze that was loaded `on_host`."""
        self.maze = maze
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(maze)]
        self._content = tuple((leaf.shape, leaf.tobytes()) for leaf in leaves)

    @classmethod
    def load(cls, maze: str | os.PathLike[str], num_decisions: int | None) -> "HostMaze":
        """Loads a maze by its name or from a file, see `mazes.load`.

        Raises:
          base.UserError: it can't be loaded, or the time limit isn't as it should be.
        """
        if num_decisions is not None:
            num_decisions = whole("num_decisions", num_decisions, limits.MAX_DECISIONS)
        return cls(mazes.load(os.fspath(maze), num_decisions=num_decisions, on_host=True))

    def __eq__(self, other: object) -> bool:
        """Returns whether the other one has the same content."""
        return isinstance(other, HostMaze) and self._content == other._content

    def __hash__(self) -> int:
        """Hashes the content."""
        return hash(self._content)

    @property
    def num_goals(self) -> int:
        """Number of goals of an episode."""
        return int(self.maze.num_goals)

    @property
    def can_move(self) -> bool:
        """Whether the maze has one goal and it is a region, which another cell may stand for."""
        return self.num_goals == 1 and bool(np.asarray(self.maze.goal).any())

    def stacked(self) -> maze_lib.Maze:
        """Returns the maze, and where its goal can move the same without goal; starts JAX."""
        no_goal = self.maze.replace(goal=np.zeros_like(np.asarray(self.maze.goal)))
        return mazes.stack([self.maze, no_goal] if self.can_move else [self.maze])

    def opened(self, row: int, goal_ij: Int[np.ndarray, "2"]) -> maze_lib.Maze:
        """Returns the maze of an episode on the host.

        Args:
          row: of `stacked`.
          goal_ij: row and column of the cell that is goal 1; `task.NO_DOOR` for its own goals.
        """
        wall, goal = np.array(self.maze.wall), np.array(self.maze.goal)
        goal[...] = 0 if row == _MOVED else goal
        if goal_ij[0] != task.NO_DOOR:
            wall[tuple(goal_ij)], goal[tuple(goal_ij)] = False, 1
        return self.maze.replace(wall=wall, goal=goal)

    def regions(self) -> Int[np.ndarray, "R C"]:
        """Numbers the goals there are: a region has one number, every other cell one of its own."""
        goal = np.asarray(self.maze.goal)
        return np.where(goal > 0, -goal, np.arange(goal.size).reshape(goal.shape))


@functools.lru_cache(maxsize=16)
def engine_of(robot: robot_lib.Robot, engine: base.EngineName) -> engine_lib.Engine:
    """Returns the engine of a robot, which environments share: it keeps nothing of a step.

    Raises:
      base.UserError: the robot can't be simulated.
    """
    return engines.make(robot, engine)


def whole(name: str, value: object, most: int) -> int:
    """Returns a whole number from 1 on.

    Raises:
      base.UserError: it isn't a whole number, or is above `most`.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise base.UserError(f"{name} = {value!r} must be a whole number")
    checks.in_range(name, int(value), 1, most)
    return int(value)


def check_options(options: object, known: tuple[str, ...]) -> Options:
    """Returns the options of a reset, of which each must be known.

    Raises:
      base.UserError: an option is unknown, or the options are no dict.
    """
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise base.UserError(f"options = {options!r} must be a dict of {', '.join(known)}")
    for name in options:
        if name not in known:
            raise base.UserError(f"options: {name!r} is unknown; known are {', '.join(known)}")
    return options


def choose(
    maze: HostMaze, options: Options, num: int, generator: np.random.Generator
) -> Places | None:
    """Returns where the episodes that a reset begins are to be, None where it is left to chance.

    Args:
      maze: the maze.
      options: `start_cell` and `goal_cell`, each row and column, counted from 0, of one cell or of
        one for each episode. One that isn't given is drawn as it would have been. A goal cell is
        free or a door, and stands instead of the maze's goal; one of the goal's own region is that
        region.
      num: number of episodes, N.
      generator: draws what isn't given.

    Raises:
      base.UserError: one of the cells is none, or is in a wall; the start is at the goal, or no way
        leads there; the maze has several goals.
    """
    if START not in options and GOAL not in options:
        return None
    starts, goals = (_cells(maze.maze, options, name, num) for name in (START, GOAL))
    chosen = [_choose(maze, *pair, generator) for pair in zip(starts, goals, strict=True)]

    row, start_ij, goal_ij = (jnp.array(column, jnp.int32) for column in zip(*chosen, strict=True))
    return Places(maze=row, place=task.Place(start_ij=start_ij, goal_ij=goal_ij))


def _cells(
    maze: maze_lib.Maze, options: Options, name: str, num: int
) -> list[paths.Cell] | list[None]:
    """Returns the cell of each episode that an option names, one for all or one for each."""
    if name not in options:
        return [None] * num

    try:
        cells = np.asarray(options[name])
        is_whole = np.issubdtype(cells.dtype, np.integer)
    except ValueError:  # rows of different lengths
        cells, is_whole = np.zeros(()), False
    if not is_whole or cells.shape not in ((2,), (num, 2)):
        rows = f", or {num} of them" if num > 1 else ""
        raise base.UserError(f"{name} = {options[name]!r} must be a row and a column{rows}")

    for cell in np.atleast_2d(cells):
        if not ((cell >= 0) & (cell < maze.wall.shape)).all():
            size = " x ".join(str(side) for side in maze.wall.shape)
            raise base.UserError(f"{name} = {cell.tolist()} is outside the {size} cells")
    return [(int(i), int(j)) for i, j in np.broadcast_to(cells, (num, 2))]


def _choose(
    host: HostMaze,
    start: paths.Cell | None,
    goal: paths.Cell | None,
    generator: np.random.Generator,
) -> tuple[int, paths.Cell, paths.Cell]:
    """Returns the maze's row, start and goal of one episode, those that aren't given drawn."""
    wall, region, door = (
        np.asarray(mask) for mask in (host.maze.wall, host.maze.goal, host.maze.door)
    )
    if start is not None and wall[start]:
        raise base.UserError(f"{START} = {list(start)} is in a wall")

    row, goal_ij = _OWN, (task.NO_DOOR, task.NO_DOOR)
    if goal is not None:
        if host.num_goals != 1:
            raise base.UserError(f"{GOAL} is for mazes of one goal, this one has {host.num_goals}")
        if wall[goal] and not door[goal]:
            raise base.UserError(f"{GOAL} = {list(goal)} is in a wall")
        if not region[goal]:
            row, goal_ij = int(host.can_move), goal
    elif door.any():
        goal_ij = _draw(door, start, generator, "goal")

    # What counts as arrived before the first step.
    is_goal = (region > 0) & (row == _OWN)
    if goal_ij[0] != task.NO_DOOR:
        is_goal[goal_ij] = True
    if start is None:
        start = _draw(np.asarray(host.maze.start) & ~is_goal, None, generator, "start")
    elif is_goal[start]:
        raise base.UserError(f"{START} = {list(start)} is at the goal")

    free = ~wall
    free[is_goal] = True
    if (paths.distances(free, [start])[is_goal] < 0).any():
        raise base.UserError(f"no way from {START} = {list(start)} to every goal")
    return row, start, goal_ij


def _draw(
    mask: np.ndarray, without: paths.Cell | None, generator: np.random.Generator, what: str
) -> paths.Cell:
    """Draws one of the true cells, all but one equally likely."""
    cells = [cell for cell in paths.cells(mask) if cell != without]
    if not cells:
        raise base.UserError(f"no {what} of the maze is left beside the given cell")
    return cells[int(generator.integers(len(cells)))]
