"""The navigation task, the same with oracle movement and with physics (paper, Sec. 4.1, App. D).

An episode draws a maze, a start and, where there are candidates, a door. The reward is 1 when the
torso first enters a goal region, in any order of the goals; the episode terminates with the last of
them and is truncated at its number of decisions.

Mazes are prepared once (`prepare`), so that a decision costs a few look-ups whatever their size: an
episode's state holds the index of its maze and its open door instead of a copy of the maze.
"""

from collections.abc import Sequence
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt8, UInt32

from eihrl_jax import base
from eihrl_jax.envs import raster
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import paths

MAX_WAY_BACK = 1.0
"""Greatest distance from the robot to an anchored subgoal's origin, units, see `anchor`."""

NO_DOOR = -1000
"""Row and column of the open door in a maze without door candidates: outside of any view."""


class MazeTable(struct.PyTreeNode):
    """M mazes prepared for the task; R and C as in `Maze`.

    Attributes:
      mazes: the mazes as they were given, with leading axis M.
      codes: uint8 [M, R + 2 m, C + 2 m], see `mazes.maze.codes`; all door candidates closed, with a
        margin of m cells of wall, which stands for everything outside the grid.
      start_ij: int32 [M, S, 2], row and column of the start cells, padded to the longest list.
      door_ij: int32 [M, D, 2], the same of the door candidates; `NO_DOOR` where there is none.
      num_starts: int32 [M].
      num_doors: int32 [M], at least 1.
      num_both: int32 [M], cells that are start and candidate; they come first in both lists.
      goal_xy: float32 [M, 9, P, 2], where the goals are, units: P places each, of which the nearest
        counts, see `mazes.maze.goal_places`; padded to the longest list.
      margin: m, at least 1 and at least the radius of a map around the robot, cells.
    """

    mazes: maze_lib.Maze
    codes: UInt8[Array, "M H W"]
    start_ij: Int[Array, "M S 2"]
    door_ij: Int[Array, "M D 2"]
    num_starts: Int[Array, "M"]
    num_doors: Int[Array, "M"]
    num_both: Int[Array, "M"]
    goal_xy: Float[Array, "M 9 P 2"]
    margin: int = struct.field(pytree_node=False)

    @property
    def num_mazes(self) -> int:
        """Number of mazes."""
        return self.codes.shape[0]


class Navigation(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      maze: int32, index of the maze in the table.
      door_ij: int32 [2], row and column of the open door, or `NO_DOOR`.
      visited: bool [9], goals that have been visited.
      decisions: int32, decisions so far.
      start_ij: int32 [2], row and column of the start cell.
      seen: bool [R + 2 m, C + 2 m], cells that have been in sight; None without a map.
    """

    maze: Int[Array, ""]
    door_ij: Int[Array, "2"]
    visited: Bool[Array, "9"]
    decisions: Int[Array, ""]
    start_ij: Int[Array, "2"]
    seen: Bool[Array, "H W"] | None = None


class Place(struct.PyTreeNode):
    """A given start and goal of an episode, in place of drawn ones.

    Attributes:
      start_ij: int32 [2], row and column of the start cell.
      goal_ij: int32 [2], row and column of the cell that becomes goal 1; `NO_DOOR` to keep the
        maze's own goals.
    """

    start_ij: Int[Array, "2"]
    goal_ij: Int[Array, "2"]


def prepare(mazes: maze_lib.Maze, margin: int = 1) -> MazeTable:
    """Prepares one maze, or several with a leading axis, for the task; host side.

    Args:
      mazes: the mazes.
      margin: rows and columns of wall around the grids, at least 1; see `raster.View.margin`.
    """
    if mazes.wall.ndim == 2:
        mazes = jax.tree.map(lambda leaf: leaf[None], mazes)

    # Lists of cells instead of masks, so that drawing a cell is one look-up.
    start, door = np.asarray(mazes.start), np.asarray(mazes.door)
    both = [paths.cells(mask) for mask in start & door]
    starts = [b + paths.cells(mask) for b, mask in zip(both, start & ~door, strict=True)]
    doors = [b + paths.cells(mask) for b, mask in zip(both, door & ~start, strict=True)]
    doors = [cells or [(NO_DOOR, NO_DOOR)] for cells in doors]
    # Goals rarely have several places; shorter lists repeat their own.
    places = [maze_lib.goal_places(goal) for goal in np.asarray(mazes.goal)]
    longest = max(len(xy) for of_maze in places for xy in of_maze)
    goal_xy = [[np.resize(xy, (longest, 2)) for xy in of_maze] for of_maze in places]
    return MazeTable(
        mazes=mazes,
        codes=jnp.pad(
            maze_lib.codes(mazes),
            ((0, 0), (margin, margin), (margin, margin)),
            constant_values=maze_lib.WALL,
        ),
        start_ij=_padded(starts),
        door_ij=_padded(doors),
        num_starts=jnp.array([len(cells) for cells in starts], jnp.int32),
        num_doors=jnp.array([len(cells) for cells in doors], jnp.int32),
        num_both=jnp.array([len(cells) for cells in both], jnp.int32),
        goal_xy=jnp.array(goal_xy, jnp.float32),
        margin=margin,
    )


def start(
    table: MazeTable,
    key: Key[Array, ""],
    maze: Int[Array, ""] | None = None,
    place: Place | None = None,
) -> tuple[Navigation, Float[Array, "2"]]:
    """Draws maze, door and start of an episode, each uniformly; no start is a goal.

    Args:
      table: the mazes.
      key: consumed.
      maze: index of the maze; None: drawn.
      place: start and goal; None: drawn.

    Returns:
      The episode at its beginning, and the robot's position in units.
    """
    # One draw for maze, door, start cell, and the offset in it on both axes: random bits are a
    # large part of a reset's cost.
    draws = jax.random.uniform(key, (5,))
    if maze is None:
        maze = pick(draws[0], jnp.int32(table.num_mazes))
    door = pick(draws[1], _of(table.num_doors, maze))

    # A cell that is both stands at the same index in both lists: so the open door, if it is a start
    # as well, is skipped.
    is_start = door < _of(table.num_both, maze)
    cell = pick(draws[2], _of(table.num_starts, maze) - is_start.astype(jnp.int32))
    cell = jnp.where(is_start & (cell >= door), cell + 1, cell)
    offset = (2.0 * draws[3:] - 1.0) * _of(table.mazes.start_jitter, maze)

    start_ij, door_ij = _of(table.start_ij, maze)[cell], _of(table.door_ij, maze)[door]
    if place is not None:
        start_ij, door_ij = place.start_ij, place.goal_ij
    nav = Navigation(
        maze=maze,
        door_ij=door_ij,
        visited=jnp.zeros(maze_lib.MAX_GOALS, bool),
        decisions=jnp.int32(0),
        start_ij=start_ij,
    )
    return nav, maze_lib.cell_xy(start_ij) + offset


def advance(
    table: MazeTable,
    nav: Navigation,
    path_xy: Float[Array, "T 2"],
    reward: base.Reward = "sparse",
) -> tuple[Navigation, base.Outcome]:
    """Counts one decision and computes its reward (paper, App. D).

    Args:
      table: the mazes.
      nav: the episode before the decision.
      path_xy: torso positions during the decision, the last one where it ended, units.
      reward: "sparse": number of goals entered for the first time. "dense": `dense_reward` where
        the decision ended; then the episode goes on after the last goal, with reward 1 for each
        decision: otherwise waiting beside the goal would be worth more.

    Returns:
      The episode after the decision, and what it led to.
    """
    # Goals along the way count, not only the one where the decision ends.
    codes = code_at(table, nav, path_xy)
    numbers = jnp.arange(1, maze_lib.MAX_GOALS + 1, dtype=jnp.uint8)
    visited = nav.visited | (codes[:, None] == numbers[None]).any(0)
    after = nav.replace(visited=visited, decisions=nav.decisions + 1)

    if reward == "dense":
        paid, is_solved = dense_reward(table, after, path_xy[-1]), jnp.zeros((), bool)
    else:
        paid = (visited & ~nav.visited).sum(dtype=jnp.float32)
        is_solved = visited.sum(dtype=jnp.int32) >= _of(table.mazes.num_goals, nav.maze)
    is_late = after.decisions >= _of(table.mazes.num_decisions, nav.maze)
    return after, base.Outcome.of_step(paid, is_solved, is_late)


def anchor(xy: Float[Array, "2"]) -> Float[Array, "2"]:
    """Returns the origin of an anchored subgoal, units: the centre of the robot's cell.

    Where the centre is farther away than `MAX_WAY_BACK`, as for a robot that leans on a wall, it is
    the point at that distance towards it. So the offsets of successive subgoals don't add up.

    Differs from the paper: its subgoals are displacements from where the robot is.
    """
    way = maze_lib.cell_xy(maze_lib.cell_ij(xy)) - xy
    distance = jnp.sqrt((way**2).sum())
    return xy + way * jnp.minimum(1.0, MAX_WAY_BACK / jnp.maximum(distance, 1e-6))


def success(table: MazeTable, nav: Navigation) -> Float[Array, ""]:
    """Returns the share of the goals that have been visited, which the paper calls success."""
    visited = nav.visited.sum(dtype=jnp.float32)
    return visited / _of(table.mazes.num_goals, nav.maze).astype(jnp.float32)


def current_goal_xy(table: MazeTable, nav: Navigation, xy: Float[Array, "2"]) -> Float[Array, "2"]:
    """Returns the position of the unvisited goal with the lowest number, units.

    Of a goal with several places it is the one nearest to `xy`, see `mazes.maze.goal_places`. Once
    all goals have been visited, it is the last one's.
    """
    # `visited` has nine entries in every maze; those beyond `num_goals` stay False.
    last = _of(table.mazes.num_goals, nav.maze) - 1
    current = jnp.where(nav.visited.all(), last, jnp.minimum(jnp.argmin(nav.visited), last))

    # In a maze with door candidates goal 1 is the open door.
    is_door = (current == 0) & (nav.door_ij[0] != NO_DOOR)
    door_xy = maze_lib.cell_xy(nav.door_ij)
    places = _of(table.goal_xy, nav.maze)[current]
    nearest = jnp.argmin(((places - xy[None]) ** 2).sum(-1)) if len(places) > 1 else 0
    return jnp.where(is_door, door_xy, places[nearest])


def dense_reward(table: MazeTable, nav: Navigation, xy: Float[Array, "2"]) -> Float[Array, ""]:
    """Returns 1 / (1 + d), d the distance in units to the current goal (paper, App. D.2).

    Once all goals have been visited, it is 1, as at the goal.
    """
    distance = jnp.sqrt(((current_goal_xy(table, nav, xy) - xy) ** 2).sum())
    current = jnp.argmin(nav.visited)
    has_arrived = nav.visited[current] | (current >= _of(table.mazes.num_goals, nav.maze))
    return jnp.where(has_arrived, 1.0, 1.0 / (1.0 + distance))


def code_at(table: MazeTable, nav: Navigation, xy: Float[Array, "*k 2"]) -> UInt8[Array, "*k"]:
    """Returns the codes of the cells at some positions, see `mazes.maze.codes`.

    Args:
      table: the mazes.
      nav: the episode, whose open door counts as goal 1.
      xy: positions, units.
    """
    i = jnp.floor(-xy[..., 1] / base.CELL).astype(jnp.int32)
    j = jnp.floor(xy[..., 0] / base.CELL).astype(jnp.int32)
    return _codes(table, nav, i, j)


def look(table: MazeTable, nav: Navigation, xy: Float[Array, "2"], view: raster.View) -> Navigation:
    """Adds the cells in sight from `xy` (units) to the map, if the view has one."""
    if not view.has_map:
        return nav
    _, rows, columns = table.codes.shape
    here = raster.in_sight((rows, columns), table.margin, xy, view)
    before = _known(table, nav, view.knows) if nav.seen is None else nav.seen
    return nav.replace(seen=before | here)


def observe(
    table: MazeTable,
    nav: Navigation,
    xy: Float[Array, "2"],
    silhouette: UInt32[Array, "P W"],
    view: raster.View,
) -> raster.Picture:
    """Draws the high level's observation: a map (`raster.draw_map`) or a picture (`raster.draw`).

    Args:
      table: the mazes.
      nav: the episode.
      xy: position of the torso, units.
      silhouette: the robot's pixels, packed into bits, see `raster.draw`; unused for a map.
      view: which of both, and how large.
    """
    if view.has_map:
        return _map(table, nav, xy, view)
    codes = _codes(table, nav, *raster.window(xy, view))
    return raster.draw(codes, xy, nav.visited, silhouette, view)


def drawn_maze(table: MazeTable, nav: Navigation) -> maze_lib.Maze:
    """Returns the maze of an episode with its door open, without leading axis."""
    maze = jax.tree.map(lambda leaf: _of(leaf, nav.maze), table.mazes)
    return maze_lib.open_door(maze, nav.door_ij)


def pick(uniform: Float[Array, ""], num: Int[Array, ""]) -> Int[Array, ""]:
    """Turns a uniform draw from [0, 1) into an index below `num`."""
    # In float32 the product can round up to `num` itself.
    index = (uniform * num.astype(jnp.float32)).astype(jnp.int32)
    return jnp.minimum(index, num - 1)


def _codes(
    table: MazeTable, nav: Navigation, i: Int[Array, "*#k"], j: Int[Array, "*#k"]
) -> UInt8[Array, "*k"]:
    """Returns the codes of cells: outside the grid they are walls, the open door is goal 1."""
    num_mazes, rows, columns = table.codes.shape

    # A flat index within bounds: look-ups by several indices are much slower on CPU.
    padded_i, padded_j = i + table.margin, j + table.margin
    flat = jnp.clip(padded_i, 0, rows - 1) * columns + jnp.clip(padded_j, 0, columns - 1)
    if num_mazes > 1:
        flat += nav.maze * rows * columns
    codes = table.codes.reshape(-1).at[flat].get(mode="promise_in_bounds")

    # The table holds no candidate as a goal; this episode's open one is goal 1.
    is_door = (i == nav.door_ij[0]) & (j == nav.door_ij[1])
    return jnp.where(is_door, jnp.uint8(1), codes)


def _known(table: MazeTable, nav: Navigation, knows: base.Knows) -> Bool[Array, "H W"]:
    """Returns which cells of the padded grid are on the map at the start of an episode."""
    if knows == "map":
        return jnp.ones(table.codes.shape[1:], bool)
    if knows == "goal":
        codes = _codes_in(table, nav, (jnp.int32(0), jnp.int32(0)), table.codes.shape[1:])
        return (codes > 0) & (codes < maze_lib.WALL)
    return jnp.zeros(table.codes.shape[1:], bool)


def _map(
    table: MazeTable, nav: Navigation, xy: Float[Array, "2"], view: raster.View
) -> raster.Picture:
    """Draws a map of the whole maze with its margin, or of the cells around the robot."""
    *shape, _ = view.obs_shape
    robot_ij = maze_lib.cell_ij(xy) + table.margin
    # The margin is as wide as a map reaches, so that the slice stays inside the padded grid.
    corner = robot_ij - view.map_radius if view.map_shape is None else jnp.zeros(2, jnp.int32)
    codes = _codes_in(table, nav, (corner[0], corner[1]), shape)
    seen = jax.lax.dynamic_slice(cast(Array, nav.seen), (corner[0], corner[1]), shape)
    return raster.draw_map(codes, seen, nav.visited, robot_ij - corner)


def _codes_in(
    table: MazeTable,
    nav: Navigation,
    corner: tuple[Int[Array, ""], Int[Array, ""]],
    shape: Sequence[int],
) -> UInt8[Array, "n m"]:
    """Returns the codes of a rectangle of the padded grid, the open door goal 1."""
    codes = jax.lax.dynamic_slice(table.codes, (nav.maze, *corner), (1, *shape))[0]
    is_row, is_column = (
        jnp.arange(size) + first == place + table.margin
        for size, first, place in zip(shape, corner, nav.door_ij, strict=True)
    )
    return jnp.where(is_row[:, None] & is_column[None], jnp.uint8(1), codes)


def _of(column: Array, maze: Int[Array, ""]) -> Array:
    """Returns one maze's entry in a column of the table, without a look-up if there is only one."""
    return column[0] if column.shape[0] == 1 else column[maze]


def _padded(cells: list[list[paths.Cell]]) -> Int[Array, "M K 2"]:
    """Stacks lists of cells, repeating the last cell of the shorter ones."""
    longest = max(len(some) for some in cells)
    return jnp.array([some + some[-1:] * (longest - len(some)) for some in cells], jnp.int32)
