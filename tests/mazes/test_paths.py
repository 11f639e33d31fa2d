import numpy as np

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


def test_legs_end_in_the_nearest_cell_and_begin_anywhere_in_the_region():
    maze = parsing.parse("#########\n#S.111.2#\n#########")
    assert paths.legs(maze) == [2, 2]
    assert paths.longest_tour(maze) == 4


def test_legs_to_a_door_that_is_closed():
    maze = parsing.parse("#####\n#S.D#\n#####")
    assert paths.legs(maze) == [-1]
    assert paths.legs(maze, (1, 1), (1, 3)) == [2]
