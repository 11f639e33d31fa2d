"""Shortest paths in mazes, on the host: which cells can be reached, and in how many moves.

One move takes the robot to one of the four neighbouring cells, as one subgoal does nominally.
Distances are counted in moves; -1 stands for a cell that can't be reached.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from eihrl_jax.mazes.maze import Maze

Cell = tuple[int, int]
"""Row and column of a cell, counted from 0."""

_FAR = 2**31 - 2
"""More moves than any way has."""


def distances(free: Bool[np.ndarray, "R C"], sources: Iterable[Cell]) -> Int[np.ndarray, "R C"]:
    """Counts the moves from the nearest of some cells to every cell.

    Args:
      free: cells that can be entered.
      sources: cells to start from; they need not be free.

    Returns:
      int32 [R, C], number of moves; -1 where there is no way.
    """
    return _moves(free, np.zeros(free.shape, np.int32), sources)[0]


def largest_part(free: Bool[np.ndarray, "R C"]) -> Bool[np.ndarray, "R C"]:
    """Returns the largest connected set of free cells, the first of equal ones."""
    labels = np.zeros(free.shape, np.int32)
    ndimage.label(free, output=labels)  # numbers parts from 1 on, in reading order
    sizes = np.bincount(labels[free], minlength=1)
    return free & (labels == sizes.argmax())


def cells(mask: Bool[np.ndarray, "R C"]) -> list[Cell]:
    """Lists the true cells of a mask in reading order."""
    return [(int(i), int(j)) for i, j in np.argwhere(mask)]


def arrivals(maze: Maze, start: Cell | None = None, door: Cell | None = None) -> list[int]:
    """Counts the moves after which each goal can be entered, all goals before it having been.

    The last one is the length of the shortest tour of all goals in their order.

    Args:
      maze: one maze, no door drawn.
      start: start cell; None: the nearest of all.
      door: the candidate that is drawn; None: none is, and goal 1 is a region of the text.

    Returns:
      Number of moves per goal, in the order of the goals; -1 where there is no way.
    """
    free, goal = _free(maze), np.array(maze.goal)  # copies, in which the door is opened
    if door is not None:
        free[door], goal[door] = True, 1
    sources = cells(np.asarray(maze.start)) if start is None else [start]
    moves = _moves(free, goal, sources, int(maze.num_goals))
    # The first place with n goals entered is the cell where the n-th was.
    return [int(layer[layer >= 0].min()) if (layer >= 0).any() else -1 for layer in moves[1:]]


def tours(maze: Maze, door: Cell | None = None) -> Int[np.ndarray, "R C"]:
    """Counts the moves of the shortest tour of all goals, in any order, from every cell.

    Args:
      maze: one maze, no door drawn.
      door: the door candidate that is open; None: none is, and goal 1 is a region of the text.

    Returns:
      int32 [R, C]; -1 where there is no such tour.
    """
    free, goal = _free(maze), np.array(maze.goal)  # copies, in which the door is opened
    if door is not None:
        free[door], goal[door] = True, 1
    all_visited = (1 << int(maze.num_goals)) - 1

    # From the end backwards: what is left once these goals have been visited, as bits.
    graph = _neighbours(free)
    left = {all_visited: np.where(free, 0.0, np.inf)}
    for visited in range(all_visited - 1, -1, -1):
        ends = np.full(free.shape, np.inf)
        for number in range(1, int(maze.num_goals) + 1):
            after = visited | 1 << (number - 1)
            if after != visited:
                ends = np.where(goal == number, left[after], ends)
        left[visited] = _nearest(graph, np.where(free, ends, np.inf))

    moves = left[0]
    return np.where(np.isfinite(moves), moves, -1).astype(np.int32)


def longest_tour(maze: Maze) -> int:
    """Bounds the moves that a shortest tour of the goals in order takes, over all starts and doors.

    The bound goes by way of the most central start, which keeps it cheap where starts and doors
    are many; it is exact for one start.

    Args:
      maze: one maze, no door drawn, in which every goal and door can be reached from every start.
    """
    # From any start to the middle one, then on as from there: no shorter than the way itself.
    starts = np.argwhere(np.asarray(maze.start))
    centre = np.abs(starts - starts.mean(0)).sum(1).argmin()
    middle = (int(starts[centre, 0]), int(starts[centre, 1]))
    reached = distances(_free(maze), [middle])
    to_middle = int(reached[np.asarray(maze.start)].max())

    door, farthest = np.asarray(maze.door), None
    if door.any():
        ways = np.where(door, with_doors(reached, door), -1)
        i, j = np.unravel_index(ways.argmax(), ways.shape)
        farthest = (int(i), int(j))
    return to_middle + arrivals(maze, middle, farthest)[-1]


def with_doors(
    reached: Int[np.ndarray, "R C"], door: Bool[np.ndarray, "R C"]
) -> Int[np.ndarray, "R C"]:
    """Adds to the moves to all cells those to doors, which are wall to each other; -1: no way."""
    # Doors lie in the ring, where a neighbour may be beyond the grid: padded as out of reach.
    far = np.pad(np.where(reached < 0, _FAR, reached), 1, constant_values=_FAR)
    nearest = np.minimum.reduce([far[:-2, 1:-1], far[2:, 1:-1], far[1:-1, :-2], far[1:-1, 2:]])
    is_new = door & (reached < 0) & (nearest < _FAR)
    return np.where(is_new, nearest + 1, reached)


def _free(maze: Maze) -> Bool[np.ndarray, "R C"]:
    """Returns the cells that can be entered while no door is open."""
    return ~np.asarray(maze.wall)


def _neighbours(free: Bool[np.ndarray, "R C"]) -> sparse.csr_array:
    """Returns the graph of the moves between neighbouring free cells, numbered in reading order."""
    number = np.arange(free.size).reshape(free.shape)
    along, down = free[:, 1:] & free[:, :-1], free[1:] & free[:-1]
    one = np.concatenate([number[:, :-1][along], number[:-1][down]])
    other = np.concatenate([number[:, 1:][along], number[1:][down]])
    return sparse.csr_array((np.ones(len(one)), (one, other)), shape=(free.size, free.size))


def _nearest(graph: sparse.csr_array, ends: Float[np.ndarray, "R C"]) -> Float[np.ndarray, "R C"]:
    """Returns for every cell the least sum of the moves to an end and what the end itself costs."""
    # All ends hang on one more place; its moves are 1 too long, for 0 would be no connection.
    costs = ends.ravel()[None] + 1.0
    to_ends = sparse.csr_array(np.where(np.isfinite(costs), costs, 0.0))
    place = sparse.block_array([[graph, None], [to_ends, sparse.csr_array((1, 1))]], format="csr")
    moves = csgraph.dijkstra(place, directed=False, indices=ends.size)
    return moves[:-1].reshape(ends.shape) - 1.0


def _moves(
    free: Bool[np.ndarray, "R C"],
    goal: Int[np.ndarray, "R C"],
    sources: Iterable[Cell],
    num_goals: int = 0,
) -> Int[np.ndarray, "K R C"]:
    """Counts the moves to every cell by how many goals have been entered in their order, from 0 on.

    A breadth-first search over places: a place is a cell together with the number of goals entered.
    """
    padded = np.pad(free, 1)  # with wall, so that neighbours need no check of the margin
    width, size = padded.shape[1], padded.size
    is_open, goals = padded.ravel().tolist(), np.pad(goal, 1).ravel().tolist()

    # Flat lists of places: single elements of arrays would be read much more slowly.
    reached = [(i + 1) * width + j + 1 for i, j in sources]
    moves = [-1] * (size * (num_goals + 1))
    for place in reached:
        moves[place] = 0
    for place in reached:  # grows while it is walked through
        num_entered, cell = divmod(place, size)
        for neighbour in (cell + 1, cell - 1, cell + width, cell - width):
            if is_open[neighbour]:
                is_next = goals[neighbour] == num_entered + 1
                there = neighbour + size * (num_entered + is_next)
                if moves[there] < 0:
                    moves[there] = moves[place] + 1
                    reached.append(there)
    return np.array(moves, np.int32).reshape(-1, *padded.shape)[:, 1:-1, 1:-1]
