import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.envs import raster
from eihrl_jax.mazes import maze as maze_lib
from tests.envs import pictures

VIEWS = [
    raster.View(),
    raster.View(extent=15.0, pixels=25),
    raster.View(extent=10.0, pixels=14),
    raster.View(extent=9.0, pixels=40),
    raster.View(extent=45.0, pixels=50),
    raster.View(extent=3.0, pixels=3),
]
every_view = pytest.mark.parametrize("view", VIEWS, ids=str)
NOTHING_VISITED = np.zeros(9, bool)


@functools.cache
def drawer(view: raster.View):
    return jax.jit(functools.partial(pictures.patch, view=view))


def draw(maze, xy, view, visited=NOTHING_VISITED, silhouette=None) -> np.ndarray:
    if silhouette is None:
        silhouette = np.zeros((view.pixels, view.pixels), bool)
    xy, visited, silhouette = map(jnp.asarray, (np.float32(xy), visited, silhouette))
    return np.asarray(drawer(view)(maze, xy, visited, silhouette))


def draw_slowly(maze, xy, view, visited=NOTHING_VISITED) -> np.ndarray:
    """Looks up the cell of every pixel."""
    wall, goal = np.asarray(maze.wall), np.asarray(maze.goal)
    picture = np.zeros((view.pixels, view.pixels, 2), bool)
    for row in range(view.pixels):
        for column in range(view.pixels):
            x = xy[0] + (column + 0.5 - view.pixels / 2) * view.extent / view.pixels
            y = xy[1] - (row + 0.5 - view.pixels / 2) * view.extent / view.pixels
            i, j = int(np.floor(-y / 3)), int(np.floor(x / 3))
            if 0 <= i < wall.shape[0] and 0 <= j < wall.shape[1]:
                number = goal[i, j]
                picture[row, column] = wall[i, j], number > 0 and not visited[number - 1]
            else:
                picture[row, column] = True, False
    return picture


@every_view
def test_every_pixel_shows_the_cell_below_its_centre(view):
    maze = mazes.load("spiral")
    rng = np.random.default_rng(0)
    for _ in range(5):
        xy = rng.uniform(3, 60, 2) * [1, -1]
        visited = rng.random(9) < 0.5
        expected = draw_slowly(maze, xy, view, visited)
        assert (draw(maze, xy, view, visited)[..., :2] == expected).all()


@every_view
def test_positions_on_the_grid_lines_do_not_leave_the_window(view):
    maze = mazes.load("s")
    for x in np.arange(3.0, 12.0, view.pitch / 2, dtype=np.float32)[:20]:
        pixels = draw(maze, (x, -x), view)[..., 0]
        assert pixels.mean() == pytest.approx(
            draw_slowly(maze, (x, -x), view)[..., 0].mean(), abs=0.2
        )


def test_a_small_picture():
    maze = mazes.parse("#####\n#.S.2\n#.1.#\n#####")
    view = raster.View(extent=9.0, pixels=9)
    picture = draw(maze, (10.5, -4.5), view)  # the centre of the free cell left of goal 2
    drawn = np.where(picture[..., 0], "#", np.where(picture[..., 1], "o", "."))
    assert ["".join(row) for row in drawn] == [
        "#########",
        "#########",
        "#########",
        "......ooo",
        "......ooo",
        "......ooo",
        "ooo...###",
        "ooo...###",
        "ooo...###",
    ]


def test_north_is_up_and_east_is_right():
    maze = mazes.load("random")
    picture = draw(maze, (4.5, -4.5), raster.View())[..., 0]  # the north-west corner
    assert picture[:5].all()
    assert picture[:, :5].all()
    assert not picture[5:, 5:].any()


def test_only_unvisited_goals_are_drawn():
    maze = mazes.parse("######\n#S12.#\n######")
    view = raster.View()
    at = (10.5, -4.5)
    assert draw(maze, at, view)[..., 1].sum() == 2 * 25
    assert draw(maze, at, view, np.arange(9) == 0)[..., 1].sum() == 25
    assert draw(maze, at, view, np.arange(9) == 1)[7, 3, 1]
    assert draw(maze, at, view, np.arange(9) < 2)[..., 1].sum() == 0


def test_a_drawn_door_is_a_hole_and_a_goal():
    maze = maze_lib.open_door(mazes.load("random"), jnp.array([0, 3]))
    picture = draw(maze, (10.5, -4.5), raster.View())
    assert picture[:5, 5:10].tolist() == np.tile([False, True, False], (5, 5, 1)).tolist()
    assert picture[:5, :5, 0].all()
    assert picture[:5, 10:, 0].all()


@every_view
def test_moving_maze_and_robot_together_changes_nothing(view):
    text = "#####\n#S.2#\n#.#.#\n#1..#\n#####"
    moved = "\n".join(["#" * 9] * 3 + ["####" + row for row in text.split()])
    for xy in ([4.23, -5.17], [10.93, -9.35]):
        here = draw(mazes.parse(text), xy, view)
        there = draw(mazes.parse(moved), (xy[0] + 12.0, xy[1] - 9.0), view)
        assert (here == there).all()


@every_view
def test_turning_the_world_turns_the_picture(view):
    text = np.array([list(row) for row in "#####\n#S.2#\n#.#.#\n#1..#\n#####".split()])
    turned = "\n".join("".join(row) for row in np.rot90(text))  # a quarter to the left
    for x, y in ([4.23, -5.17], [10.93, -9.35]):
        here = draw(mazes.parse("\n".join(map("".join, text))), (x, y), view)
        there = draw(mazes.parse(turned), (-y, -15.0 + x), view)
        assert (np.rot90(here) == there).all()


@every_view
def test_the_silhouette_is_the_third_channel(view):
    silhouette = np.random.default_rng(0).random((view.pixels, view.pixels)) < 0.3
    picture = draw(mazes.load("u"), (10.0, -10.0), view, silhouette=silhouette)
    assert (picture[..., 2] == silhouette).all()


def footprint(view, *capsules) -> np.ndarray:
    """Draws capsules given as (start x, start y, end x, end y, radius)."""
    numbers = jnp.array(capsules, jnp.float32)
    start, end = (jnp.pad(numbers[:, i : i + 2], ((0, 0), (0, 1))) for i in (0, 2))
    return np.asarray(raster.footprint((start, end, numbers[:, 4]), jnp.zeros(2), view))


def test_a_disc_has_the_area_of_a_disc():
    view = raster.View(extent=9.0, pixels=128)
    disc = footprint(view, (0.0, 0.0, 0.0, 0.0, 2.0))
    area = np.pi * (2.0 + view.pitch / 2) ** 2
    assert disc.sum() * view.pitch**2 == pytest.approx(area, rel=0.01)
    assert (disc == np.rot90(disc)).all()


def test_a_thin_leg_is_a_line_without_gaps_to_where_it_ends():
    view = raster.View()
    leg = footprint(view, (0.0, 0.0, 2.0, 0.0, 0.01))
    assert leg.sum() == 4
    assert leg[7, 7:11].all()
    slanted = footprint(view, (0.0, 0.0, 2.4, 3.0, 0.05))
    rows, columns = np.nonzero(slanted)
    assert set(rows) == set(range(2, 8))  # north is up
    assert set(columns) == set(range(7, 12))


def test_a_footprint_turns_with_the_robot():
    view = raster.View(extent=9.0, pixels=31)
    legs = np.random.default_rng(0).uniform(-3, 3, (6, 4))
    turned = np.stack([-legs[:, 1], legs[:, 0], -legs[:, 3], legs[:, 2]], -1)
    radius = np.full((6, 1), 0.21)
    here = footprint(view, *np.hstack([legs, radius]))
    assert (np.rot90(here) == footprint(view, *np.hstack([turned, radius]))).all()


@pytest.mark.parametrize("option", [{"extent": 2.9}, {"extent": 45.1}, {"extent": np.nan}])
def test_extent_out_of_range(option):
    with pytest.raises(base.UserError, match=r"view extent = .* must be at least 3.0 and at most"):
        raster.View(**option)


@pytest.mark.parametrize("pixels", [2, 129])
def test_pixels_out_of_range(pixels):
    with pytest.raises(base.UserError, match=f"view pixels = {pixels} must be"):
        raster.View(pixels=pixels)
