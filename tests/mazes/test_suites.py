"""The suites of others: their mazes are whole, and nobody has been trained in one."""

import re

import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.config import presets
from eihrl_jax.mazes import generators, paths, perfect, suites

NUM = {
    "paper": 7,
    "jaxued": 11,
    "ogbench": 15,
    "jaxgcrl": 7,
    "gymnasium-robotics": 10,
    "perfect-19": 10,
    "perfect-51": 10,
    "perfect-101": 10,
    "development": 48,
}
SHORTEST = {  # moves, and the suite's limit where it has one
    "jaxued-trivial-maze": (6, 50),
    "jaxued-sixteen-rooms": (20, 450),
    "jaxued-sixteen-rooms-2": (22, 450),
    "jaxued-labyrinth": (96, 450),
    "jaxued-labyrinth-flipped": (96, 450),
    "jaxued-labyrinth-2": (96, 450),
    "jaxued-standard-maze": (40, 450),
    "jaxued-standard-maze-2": (56, 450),
    "jaxued-standard-maze-3": (39, 450),
    "ogbench-giant-1": (30, 120),
    "ogbench-medium-3": (6, 24),
    "jaxgcrl-hardest": (15, 60),
}
LIMITS = {"perfect-19": 882, "perfect-51": 5_618, "perfect-101": 21_218}


@pytest.mark.parametrize("suite", suites.NAMES)
def test_a_suite_stands_for_its_mazes_each_with_origin_and_licence(suite):
    loaded = mazes.load_all([suite])
    assert len(loaded) == NUM[suite]
    assert suites.complete(loaded) == {suite: list(loaded)}
    assert not suites.complete(list(loaded)[1:])
    assert all(named.origin and named.licence for named in suites.mazes(suite).values())
    for name, maze in loaded.items():
        # Else four times the shortest tour, as of every text.
        assert maze.num_decisions == LIMITS.get(suite, maze.num_decisions), name


@pytest.mark.parametrize("name", SHORTEST)
def test_shortest_tours_and_limits_of_known_mazes(name):
    maze = mazes.load(name)
    assert (paths.longest_tour(maze), int(maze.num_decisions)) == SHORTEST[name]
    assert mazes.load(name, num_decisions=77).num_decisions == 77


def test_a_suite_is_no_maze_and_no_maze_comes_twice():
    with pytest.raises(
        base.UserError, match="'ogbench': a suite of several mazes, name one of ogb"
    ):
        mazes.load("ogbench")
    with pytest.raises(base.UserError, match="second one called 'jaxued-labyrinth'"):
        mazes.load_all(["jaxued", "jaxued-labyrinth"])
    with pytest.raises(
        base.UserError,
        match="'jaxued-labyrinth-9': neither a file nor one of.*; did you mean jaxued-labyrinth",
    ):
        mazes.load("jaxued-labyrinth-9")


def test_perfect_mazes_have_one_way_between_any_two_places_and_are_the_same_again():
    text = perfect.perfect_maze(3, 9, 13)
    assert text == perfect.perfect_maze(3, 9, 13) != perfect.perfect_maze(4, 9, 13)
    maze = mazes.parse(text)
    free = ~np.asarray(maze.wall)
    assert free[1::2, 1::2].all() and maze.wall.shape == (11, 15)
    # A tree has one edge fewer than places.
    assert (free[1:] & free[:-1]).sum() + (free[:, 1:] & free[:, :-1]).sum() == free.sum() - 1
    assert (paths.distances(free, [(1, 1)]) >= 0).sum() == free.sum()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 8, 9), "rows = 8 must be odd"),
        ((0, 9, 1), "columns = 1 must be at least 3"),
        ((-1, 9, 9), "seed = -1"),
        ((0, 9, 2_049), "columns = 2049 must be at least 3 and at most 2047"),
    ],
)
def test_perfect_mazes_have_limits(arguments, message):
    with pytest.raises(base.UserError, match=re.escape(message)):
        perfect.perfect_maze(*arguments)


def test_opened_cells_let_ways_meet_again():
    closed, opened = (perfect.perfect_maze(3, 9, 13, loops=loops) for loops in (0.0, 1.0))
    assert closed == perfect.perfect_maze(3, 9, 13)
    assert opened.count("#") == 2 * (11 + 13)
    with pytest.raises(base.UserError, match="loops = 1.5 must be at least 0"):
        perfect.perfect_maze(3, 9, 13, loops=1.5)


def shapes_of(wall):
    """A layout without its ring, turned and mirrored in all eight ways."""
    inside = wall[1:-1, 1:-1]
    turned = [np.rot90(inside, k) for k in range(4)]
    return {(each.shape, each.tobytes()) for part in turned for each in (part, part.T.copy())}


def in_ring(mask):
    ring = mask.copy()
    ring[1:-1, 1:-1] = False
    return ring


def test_nothing_of_a_suite_is_in_a_training_stream():
    # The paper's own mazes are apart: `best` is trained in its Random Square.
    tested = {}
    for suite in suites.NAMES[1:]:
        for name, maze in mazes.load_all([suite]).items():
            goals = (np.asarray(maze.goal) > 0) | np.asarray(maze.door)
            assert suite == suites.DEVELOPMENT or not in_ring(goals).any(), name
            tested |= {shape: name for shape in shapes_of(np.asarray(maze.wall))}

    task = presets.HIGH["best"].task
    trained = {task.maze: mazes.load(task.maze)}
    for seed in range(5):
        rooms = generators.training_rooms(
            seed, 60, sides=task.room_sides, wall_share=task.room_walls, num_decisions=24
        )
        trained |= {f"room {i} of lot {seed}": room for i, room in enumerate(rooms)}

    # Every room that is trained in has its goals in its ring, and nowhere else.
    for where, maze in trained.items():
        goals = (np.asarray(maze.goal) > 0) | np.asarray(maze.door)
        assert in_ring(goals).sum() == goals.sum() > 0, where
        assert tested.keys().isdisjoint(shapes_of(np.asarray(maze.wall))), where
