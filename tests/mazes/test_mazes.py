import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import paths

SIZES = {name: (9, 9) for name in ("random", "u", "g1", "g2", "g3")}
SIZES |= {"s": (9, 16), "spiral": (23, 23)}
LIMITS = {name: 24 for name in SIZES} | {"s": 40, "spiral": 200}
LEGS = {
    "u": [10],
    "g1": [10],
    "g2": [13],
    "g3": [8],
    "s": [6, 9, 9],
    "spiral": [12, 23, 21, 16, 24],
}


@pytest.fixture(params=mazes.NAMES)
def named(request):
    return request.param, mazes.load(request.param)


def test_sizes_and_time_limits_are_the_papers(named):
    name, maze = named
    assert maze.wall.shape == SIZES[name]
    assert maze.num_decisions == LIMITS[name]
    assert mazes.load(name, num_decisions=7).num_decisions == 7


def test_a_goal_region_is_free_numbered_from_one_and_apart_from_starts(named):
    _, maze = named
    present = set(np.unique(np.asarray(maze.goal))) - {0}
    assert present == set(range(1, int(maze.num_goals) + 1)) or bool(maze.door.any())
    assert not (maze.wall & (maze.goal > 0)).any()
    assert not (maze.wall & maze.start).any()
    assert not (maze.start & (maze.goal > 0)).any()


@pytest.mark.parametrize("name", LEGS)
def test_shortest_paths(name):
    assert paths.arrivals(mazes.load(name)) == list(itertools.accumulate(LEGS[name]))


def test_the_random_square_has_28_doors_and_49_starts_in_reach_of_each_other():
    maze = mazes.load("random")
    doors, starts = paths.cells(np.asarray(maze.door)), paths.cells(np.asarray(maze.start))
    assert (len(doors), len(starts)) == (28, 49)
    moves = [paths.arrivals(maze, start, door)[0] for start in starts for door in doors]
    assert (min(moves), max(moves), paths.longest_tour(maze)) == (1, 13, 13)
    assert np.mean(moves) == pytest.approx(6.3, abs=0.05)


def test_positions_and_cells_are_inverse():
    ij = jnp.stack(jnp.meshgrid(jnp.arange(5), jnp.arange(7)), -1).reshape(-1, 2)
    xy = jax.vmap(maze_lib.cell_xy)(ij)
    assert (jax.vmap(maze_lib.cell_ij)(xy) == ij).all()
    assert xy[0].tolist() == [1.5, -1.5]
    assert maze_lib.cell_xy(jnp.array([2, 0])).tolist() == [1.5, -7.5]


def test_positions_outside_are_wall_without_goal():
    maze = mazes.load("s")
    for xy in ([-0.1, -10.0], [48.1, -19.0], [20.0, 0.1], [20.0, -27.1]):
        assert maze_lib.is_wall(maze, jnp.array(xy))
        assert maze_lib.goal_at(maze, jnp.array(xy)) == 0
    assert maze_lib.goal_at(maze, jnp.array([46.0, -19.0])) == 3
    assert not maze_lib.is_wall(maze, jnp.array([46.0, -19.0]))


def test_a_goal_is_in_the_middle_of_its_region():
    first, *others = maze_lib.goal_places(np.asarray(mazes.load("u").goal))
    assert first.tolist() == [[6.0, -7.5]]
    assert all(xy.tolist() == [[0.0, 0.0]] for xy in others)
    assert maze_lib.goal_places(np.asarray(mazes.load("s").goal))[2].tolist() == [[46.5, -21.0]]


def test_an_open_door_is_goal_1_and_the_only_hole_in_the_ring():
    maze = mazes.load("random")
    opened = maze_lib.open_door(maze, jnp.array([0, 3]))
    assert paths.cells(np.asarray(opened.goal == 1)) == [(0, 3)]
    assert paths.cells(np.asarray(maze.wall & ~opened.wall)) == [(0, 3)]
    closed = maze_lib.open_door(maze, jnp.array([-1, -1]))
    assert (closed.wall == maze.wall).all()
    assert (closed.goal == 0).all()


def test_draw_start_is_uniform_over_cells_and_offsets():
    maze = mazes.load("random")
    keys = jax.random.split(jax.random.key(0), 4900)
    xy = jax.jit(jax.vmap(maze_lib.draw_start, (None, 0)))(maze, keys)
    ij = jax.vmap(maze_lib.cell_ij)(xy)
    counts = np.zeros((9, 9))
    np.add.at(counts, (ij[:, 0], ij[:, 1]), 1)
    assert (counts[1:-1, 1:-1].sum(), counts[1:-1, 1:-1].min() > 0) == (4900, True)
    chi_square = ((counts[1:-1, 1:-1] - 100) ** 2 / 100).sum()
    assert chi_square < 85  # 48 degrees of freedom: exceeded once in a thousand times
    offset = xy - jax.vmap(maze_lib.cell_xy)(ij)
    assert jnp.abs(offset).max() <= 0.75
    assert offset.std(0) == pytest.approx(0.75 / 3**0.5, rel=0.05)


def test_stack_pads_with_wall_and_keeps_coordinates():
    parts = [mazes.load("u"), mazes.load("s")]
    both = mazes.stack(parts)
    assert both.wall.shape == (2, 9, 16)
    assert both.wall[0, :, 9:].all()
    assert not both.start[0, :, 9:].any()
    assert (both.goal[0, :, :9] == parts[0].goal).all()
    assert (both.goal[1] == parts[1].goal).all()
    assert both.num_goals.tolist() == [1, 3]


def test_load_reads_a_file(tmp_path):
    path = tmp_path / "mine.txt"
    path.write_text("\n#####\r\n#S.1#  \n#####\n\n", encoding="utf-8-sig")
    maze = mazes.load(path)
    assert maze.wall.shape == (3, 5)
    assert (maze.num_goals, maze.num_decisions) == (1, 24)
    assert mazes.load(str(path), num_decisions=9).num_decisions == 9


def test_load_says_what_it_cannot_read(tmp_path):
    with pytest.raises(base.UserError, match=r"'maze7'.*neither a file nor one of random, u"):
        mazes.load("maze7")
    with pytest.raises(base.UserError, match="not a file"):
        mazes.load(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00#")
    with pytest.raises(base.UserError, match="not a text"):
        mazes.load(tmp_path / "binary")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(base.UserError, match="20000000 bytes"):
        mazes.load(tmp_path / "huge")
    with pytest.raises(base.UserError, match="name too long"):
        mazes.load("x" * 5000)
