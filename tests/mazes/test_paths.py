import itertools

import numpy as np

from eihrl_jax import mazes
from eihrl_jax.mazes import parsing, paths


def free_of(text: str) -> np.ndarray:
    return np.array([[c == "." for c in row] for row in text.split()])


def test_distances_go_around_walls():
    free = free_of("...  .#.  .#.")
    expected = [[2, 3, 4], [1, -1, 5], [0, -1, 6]]
    assert paths.distances(free, [(2, 0)]).tolist() == expected


def test_distances_to_the_nearest_of_several_cells():
    assert paths.distances(free_of(".....#."), [(0, 0), (0, 4)]).tolist() == [
        [0, 1, 2, 1, 0, -1, -1]
    ]


def test_distances_agree_with_repeated_relaxation():
    rng = np.random.default_rng(0)
    for _ in range(20):
        free = rng.random((8, 9)) < 0.7
        source = tuple(rng.integers(8, size=2).tolist())
        far = np.full((10, 11), 1000)
        far[source[0] + 1, source[1] + 1] = 0
        for _ in range(80):
            around = np.minimum.reduce([np.roll(far, s, a) for s in (1, -1) for a in (0, 1)])
            far[1:-1, 1:-1] = np.where(
                free, np.minimum(far, around + 1)[1:-1, 1:-1], far[1:-1, 1:-1]
            )
        expected = np.where(far >= 1000, -1, far)[1:-1, 1:-1]
        assert (paths.distances(free, [source]) == expected).all()


def test_largest_part():
    free = free_of("..#.  ..#.  ###.  ..#.")
    assert paths.largest_part(free).tolist() == free_of("..##  ..##  ####  ####").tolist()
    assert not paths.largest_part(np.zeros((2, 3), bool)).any()


def test_a_tour_leads_through_a_region_and_not_from_its_far_side():
    maze = parsing.parse("#########\n#S.111.2#\n#########")
    assert paths.arrivals(maze) == [2, 6]
    assert paths.longest_tour(maze) == 6


def test_a_tour_enters_a_region_where_the_rest_of_it_is_shortest():
    # The nearest cell of region 1 is a detour: region 2 lies behind the other one.
    maze = parsing.parse("#######\n#1S.1.#\n#####2#\n#######")
    assert paths.arrivals(maze) == [1, 4]


def test_a_tour_passes_later_goals_that_do_not_count_yet():
    maze = parsing.parse("#######\n#S.2.1#\n#######")
    assert paths.arrivals(maze) == [4, 6]


def test_the_time_limit_of_a_text_leads_through_its_regions():
    row = "#S" + 60 * "1" + "2#"
    maze = parsing.parse("\n".join(["#" * len(row), row, "#" * len(row)]))
    assert maze.num_decisions == 4 * 61


def test_arrival_at_a_door_that_is_closed():
    maze = parsing.parse("#####\n#S.D#\n#####")
    assert paths.arrivals(maze) == [-1]
    assert paths.arrivals(maze, (1, 1), (1, 3)) == [2]


def test_tours_of_every_cell_equal_those_that_all_orders_give():
    """By permutations of three goals that are single cells, in a room with walls."""
    maze = mazes.parse(
        """
        #######
        #S.#.3#
        #.....#
        #1#.#2#
        #..S..#
        #######
        """.replace("        ", "")
    )
    free = ~np.asarray(maze.wall)
    goals = [paths.cells(np.asarray(maze.goal) == number)[0] for number in (1, 2, 3)]
    ways = {goal: paths.distances(free, [goal]) for goal in goals}
    moves = paths.tours(maze)
    for cell in paths.cells(free):
        expected = min(
            sum(ways[after][before] for before, after in itertools.pairwise([cell, *order]))
            for order in itertools.permutations(goals)
        )
        assert moves[cell] == expected
    assert (moves[~free] == -1).all()
