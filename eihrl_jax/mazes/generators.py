"""Random rooms of any size with inner walls and several door candidates, always solvable.

Straight walls are added to an empty room; what they cut off from its largest part is filled with
wall, so that every start leads to every door. Also: any maze with its goal elsewhere.
"""

import numpy as np
from jaxtyping import Bool

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import parsing, paths
from eihrl_jax.mazes.maze import Maze

MAX_INSIDE = 254
"""Largest number of rows or columns inside the outer ring of a random room."""

MAX_LENGTH = 6
"""Longest inner wall in cells; walls are also at most half as long as the room."""

FIRST_SEED = 2**32
"""Lowest seed of the rooms that high levels train in: those below are for tests."""

MAX_ROOMS = 2**20
"""Most rooms in a lot to train in, and the number of seeds that each lot has of its own."""

MAX_PLACES = 1_000
"""Most places of a maze whose goal is moved: each of them becomes a maze of its own."""

MAX_WALL_SHARE = 0.4
"""Largest share of inner wall: above it too little of a room is connected."""


def random_room(
    seed: int, rows: int, columns: int, *, wall_share: float = 0.2, num_doors: int = 4
) -> str:
    """Draws the text of a random room; the same arguments give the same room.

    Args:
      seed: of the room, at least 0.
      rows: number of rows inside the outer ring.
      columns: number of columns inside the outer ring.
      wall_share: share of the inside at which no further wall is added, 0 to 0.4.
      num_doors: number of door candidates; fewer if the ring has no place for them.

    Returns:
      A text for `parsing.parse`: every free cell is a start candidate.

    Raises:
      base.UserError: an argument out of its limits.
    """
    checks.in_range("seed", seed, 0)
    checks.in_range("rows", rows, 1, MAX_INSIDE)
    checks.in_range("columns", columns, 1, MAX_INSIDE)
    checks.in_range("wall_share", wall_share, 0.0, MAX_WALL_SHARE)
    checks.in_range("num_doors", num_doors, 1)

    rng = np.random.default_rng(seed)
    places: list[paths.Cell] = []
    grid = np.full((rows + 2, columns + 2), "#")

    # Drawn anew where no free cell is left at the ring, so that no door could be there.
    while not places:
        free = paths.largest_part(~_straight_walls(rng, rows, columns, wall_share))
        grid[1:-1, 1:-1] = np.where(free, "S", "#")
        places = _door_places(grid == "S")

    for index in rng.permutation(len(places))[:num_doors]:
        grid[places[index]] = "D"
    return "\n".join("".join(row) for row in grid) + "\n"


def random_maze(
    seed: int,
    rows: int,
    columns: int,
    *,
    wall_share: float = 0.2,
    num_doors: int = 4,
    num_decisions: int | None = None,
) -> Maze:
    """Draws a random room as a maze, see `random_room` and `parsing.parse`."""
    text = random_room(seed, rows, columns, wall_share=wall_share, num_doors=num_doors)
    return parsing.parse(text, name=f"room {seed}", num_decisions=num_decisions)


def training_rooms(
    seed: int,
    num: int,
    *,
    sides: tuple[int, int],
    wall_share: float,
    num_decisions: int | None = None,
) -> list[Maze]:
    """Draws rooms of many sizes to train in, none of which `random_room` has below `FIRST_SEED`.

    Args:
      seed: of the lot; two lots have no seed of a room in common.
      num: number of rooms, at most `MAX_ROOMS`.
      sides: least and greatest number of rows, and of columns, inside the outer ring.
      wall_share: greatest share of inner wall; each room draws its own below it.
      num_decisions: time limit of all; None: each its own, see `parsing.parse`.

    Raises:
      base.UserError: an argument out of its limits.
    """
    checks.in_range("num", num, 1, MAX_ROOMS)
    checks.in_range("wall_share", wall_share, 0.0, MAX_WALL_SHARE)

    # One stream for the sizes of a lot's rooms; what is in a room comes from its own seed.
    first = FIRST_SEED + seed * MAX_ROOMS
    rng = np.random.default_rng(first)
    least, greatest = sides
    return [
        random_maze(
            first + index,
            int(rng.integers(least, greatest + 1)),
            int(rng.integers(least, greatest + 1)),
            wall_share=float(rng.uniform(0.0, wall_share)),
            num_decisions=num_decisions,
        )
        for index in range(num)
    ]


def goals_anywhere(maze: Maze) -> Maze:
    """Returns a maze many times over, each time with another of its places as the only goal.

    Learners that are told their goal can be trained in these and tested in the maze itself.

    Args:
      maze: one maze.

    Returns:
      Mazes with a leading axis, one per cell or door that can be reached from a start, other doors
      being shut and the goal's own cell no start; a place that would leave no start is left out.

    Raises:
      base.UserError: there are more than `MAX_PLACES` such places.

    Source: the training of HIRO, HRAC and HIGL, whose goals are drawn all over the maze (Nachum et
      al. 2018).
    """
    # Doors are ends of ways and lead nowhere, so they are wall to all places but themselves.
    wall, start = np.asarray(maze.wall), np.asarray(maze.start)
    door = np.asarray(maze.door) & wall
    places = paths.cells(paths.distances(~wall, paths.cells(start)) >= 0)
    if len(places) > MAX_PLACES:
        raise base.UserError(
            f"goals anywhere: the maze has {len(places)} places, must be at most {MAX_PLACES}"
        )

    variants = []
    for cell in [*places, *paths.cells(door)]:
        goal = np.zeros(wall.shape, bool)
        goal[cell] = True
        # A door is wall elsewhere, so that only the one that is the goal is entered.
        if paths.distances(~wall | goal, paths.cells(start & ~goal))[cell] >= 0:
            variants.append(
                maze.replace(
                    wall=wall & ~goal,
                    goal=goal.astype(np.int32),
                    start=start & ~goal,
                    door=np.zeros_like(door),
                    num_goals=np.int32(1),
                )
            )
    return maze_lib.stack(variants)


def _straight_walls(
    rng: np.random.Generator, rows: int, columns: int, wall_share: float
) -> Bool[np.ndarray, "rows columns"]:
    """Draws straight walls until the next one would exceed their share."""
    wall = np.zeros((rows, columns), bool)
    while True:
        is_row = rng.random() < 0.5
        # At most half as long as the room, so that one wall alone can't divide it.
        longest = min(MAX_LENGTH, max(1, (columns if is_row else rows) // 2))
        length = rng.integers(1, longest + 1)
        i, j = rng.integers(rows), rng.integers(columns)

        # What would reach beyond the room is cut off by the slice.
        more = wall.copy()
        if is_row:
            more[i, j : j + length] = True
        else:
            more[i : i + length, j] = True
        if more.mean() > wall_share:
            return wall
        wall = more


def _door_places(free: Bool[np.ndarray, "R C"]) -> list[paths.Cell]:
    """Lists the cells of the outer ring beside a free cell."""
    # Corners never are: their two neighbours are ring as well.
    beside = np.zeros_like(free)
    beside[0], beside[-1] = free[1], free[-2]
    beside[:, 0] |= free[:, 1]
    beside[:, -1] |= free[:, -2]
    return paths.cells(beside)
