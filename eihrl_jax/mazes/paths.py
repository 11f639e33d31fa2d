"""Shortest paths in mazes, on the host: which cells can be reached, and in how many moves.

One move takes the robot to one of the four neighbouring cells, as one subgoal does nominally.
Distances are counted in moves; -1 stands for a cell that can't be reached.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Int

from eihrl_jax.mazes.maze import Maze

Cell = tuple[int, int]
"""Row and column of a cell, counted from 0."""


def distances(free: Bool[np.ndarray, "R C"], sources: Iterable[Cell]) -> Int[np.ndarray, "R C"]:
    """Counts the moves from the nearest of some cells to every cell.

    Args:
      free: cells that can be entered.
      sources: cells to start from; they need not be free.

    Returns:
      int32 [R, C], number of moves; -1 where there is no way.
    """
    is_open, width = _flat(free)
    moves = [-1] * len(is_open)
    _flood(is_open, width, [(i + 1) * width + j + 1 for i, j in sources], moves)
    return _grid(moves, width)


def largest_part(free: Bool[np.ndarray, "R C"]) -> Bool[np.ndarray, "R C"]:
    """Returns the largest set of free cells that hang together, the first of equal ones."""
    is_open, width = _flat(free)
    moves, largest = [-1] * len(is_open), []
    for cell in np.flatnonzero(is_open).tolist():
        if moves[cell] < 0:
            largest = max(largest, _flood(is_open, width, [cell], moves), key=len)
    is_in = np.zeros(len(is_open), bool)
    is_in[largest] = True
    return is_in.reshape(-1, width)[1:-1, 1:-1]


def cells(mask: Bool[np.ndarray, "R C"]) -> list[Cell]:
    """Lists the true cells of a mask in reading order."""
    return [(int(i), int(j)) for i, j in np.argwhere(mask)]


def arrivals(maze: Maze, start: Cell | None = None, door: Cell | None = None) -> list[int]:
    """Counts the moves after which each goal can be entered, all goals before it having been.

    The last one is the length of the shortest tour of all goals in their order.

    Args:
      maze: one maze, no door drawn.
      start: start cell; None: the nearest of all.
      door: the door candidate that is open; None: none is, and goal 1 is a region of the text.

    Returns:
      Number of moves per goal, in the order of the goals; -1 where there is no way.
    """
    free, goal = _free(maze), np.array(maze.goal)
    if door is not None:
        free[door], goal[door] = True, 1
    is_open, width = _flat(free)
    goals, size = np.pad(goal, 1).ravel().tolist(), len(is_open)
    found = [-1] * int(maze.num_goals)
    sources = cells(np.asarray(maze.start)) if start is None else [start]
    # A place is a cell together with the goals entered so far: cell + size * number of goals.
    moves = {(i + 1) * width + j + 1: 0 for i, j in sources}
    reached = list(moves)
    for place in reached:  # grows while it is walked through
        num_entered, cell = divmod(place, size)
        for neighbour in (cell + 1, cell - 1, cell + width, cell - width):
            is_next = goals[neighbour] == num_entered + 1
            there = neighbour + size * (num_entered + is_next)
            if is_open[neighbour] and there not in moves:
                moves[there] = moves[place] + 1
                reached.append(there)
                if is_next and found[num_entered] < 0:
                    found[num_entered] = moves[there]
    return found


def longest_tour(maze: Maze) -> int:
    """Bounds the moves that a shortest tour of the goals in order takes, over all starts and doors.

    The bound goes by way of the most central start, which keeps it cheap where starts and doors
    are many; it is exact for one start.

    Args:
      maze: one maze, no door drawn, in which every goal and door can be reached from every start.
    """
    starts = np.argwhere(np.asarray(maze.start))
    centre = np.abs(starts - starts.mean(0)).sum(1).argmin()
    middle = (int(starts[centre, 0]), int(starts[centre, 1]))
    reached = distances(_free(maze), [middle])
    to_middle = int(reached[np.asarray(maze.start)].max())
    doors = cells(np.asarray(maze.door))
    if not doors:
        return to_middle + arrivals(maze, middle)[-1]
    farthest = max(doors, key=lambda door: way_to_door(reached, door))
    return to_middle + arrivals(maze, middle, farthest)[-1]


def way_to_door(reached: Int[np.ndarray, "R C"], door: Cell) -> int:
    """Returns the moves to a door, given those to all other cells; -1 where there is no way."""
    around = np.pad(reached, 1, constant_values=-1)
    i, j = door[0] + 1, door[1] + 1
    nearest = [int(n) for n in around[[i - 1, i + 1, i, i], [j, j, j - 1, j + 1]] if n >= 0]
    return min(nearest) + 1 if nearest else -1


def _free(maze: Maze) -> Bool[np.ndarray, "R C"]:
    """Returns the cells that can be entered while no door is open."""
    return ~(np.asarray(maze.wall) | np.asarray(maze.door))


def _flat(free: Bool[np.ndarray, "R C"]) -> tuple[list[bool], int]:
    """Lists the cells in reading order with a closed margin of one; returns also their width."""
    padded = np.pad(free, 1)
    return padded.ravel().tolist(), padded.shape[1]


def _grid(flat: list[int], width: int) -> Int[np.ndarray, "R C"]:
    """Undoes `_flat`."""
    return np.array(flat, np.int32).reshape(-1, width)[1:-1, 1:-1]


def _flood(is_open: list[bool], width: int, sources: list[int], moves: list[int]) -> list[int]:
    """Writes the moves from the sources to the cells around that have none yet; lists them all."""
    reached = list(sources)
    for cell in reached:
        moves[cell] = 0
    for cell in reached:  # grows while it is walked through
        for neighbour in (cell + 1, cell - 1, cell + width, cell - width):
            if is_open[neighbour] and moves[neighbour] < 0:
                moves[neighbour] = moves[cell] + 1
                reached.append(neighbour)
    return reached
