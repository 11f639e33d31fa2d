import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.envs import raster, task
from eihrl_jax.mazes import maze as maze_lib
from tests.envs import pictures

SEVEN = mazes.stack([mazes.load(name) for name in mazes.NAMES])

start = jax.jit(task.start)
starts_of = jax.jit(jax.vmap(task.start, (None, 0)))
advance = jax.jit(task.advance, static_argnames="reward")
dense_reward = jax.jit(task.dense_reward)
current_goal_xy = jax.jit(task.current_goal_xy)
code_at = jax.jit(task.code_at)
look = jax.jit(task.look, static_argnums=3)
observe = jax.jit(task.observe, static_argnums=4)


def starts(table, num, seed=0):
    keys = jax.random.split(jax.random.key(seed), num)
    return starts_of(table, keys)


def at(table, **fields):
    nav = task.Navigation(
        maze=jnp.int32(0),
        door_ij=jnp.array([task.NO_DOOR] * 2),
        visited=jnp.zeros(9, bool),
        decisions=jnp.int32(0),
        start_ij=jnp.zeros(2, jnp.int32),
    )
    return nav.replace(**fields)


def centre(i, j):
    return maze_lib.cell_xy(jnp.array([i, j]))


def test_an_episode_begins_on_a_free_start_cell_apart_from_goals():
    table = task.prepare(SEVEN)
    nav, xy = starts(table, 300)
    for maze in range(7):
        assert (nav.maze == maze).sum() > 20
    codes = jax.jit(jax.vmap(task.code_at, (None, 0, 0)))(table, nav, xy)
    assert (codes == 0).all()
    ij = jax.vmap(maze_lib.cell_ij)(xy)
    assert SEVEN.start[nav.maze, ij[:, 0], ij[:, 1]].all()


def test_the_maze_of_an_episode_can_be_given():
    nav, _ = start(task.prepare(SEVEN), jax.random.key(0), jnp.int32(3))
    assert nav.maze == 3


def test_doors_and_starts_are_uniform():
    nav, xy = starts(task.prepare(mazes.load("random")), 5600)
    _, counts = np.unique(np.asarray(nav.door_ij), axis=0, return_counts=True)
    assert len(counts) == 28
    assert ((counts - 200) ** 2 / 200).sum() < 56  # chi-square of 27, exceeded once in a thousand
    _, counts = np.unique(np.floor(np.asarray(xy) / 3), axis=0, return_counts=True)
    assert len(counts) == 49
    assert ((counts - 5600 / 49) ** 2 / (5600 / 49)).sum() < 85


def test_a_maze_without_candidates_has_no_door():
    nav, _ = starts(task.prepare(SEVEN), 100)
    has_door = (nav.door_ij != task.NO_DOOR).all(-1)
    assert (has_door == (nav.maze == 0)).all()


def test_the_open_door_is_a_goal_and_the_others_are_wall():
    table = task.prepare(mazes.load("random"))
    nav = at(table, door_ij=jnp.array([3, 8]))
    assert code_at(table, nav, centre(3, 8)) == 1
    assert code_at(table, nav, centre(4, 8)) == maze_lib.WALL
    assert code_at(table, nav, centre(3, 9)) == maze_lib.WALL
    assert code_at(table, nav, jnp.array([1e6, -1e6])) == maze_lib.WALL
    drawn = task.drawn_maze(table, nav)
    assert (drawn.goal[3, 8], drawn.wall.sum()) == (1, 31)


def test_codes_agree_with_the_drawn_maze():
    table = task.prepare(SEVEN)
    nav, _ = starts(table, 40)
    rng = np.random.default_rng(0)
    xy = jnp.asarray(rng.uniform(-5, 75, (40, 50, 2)) * [1, -1], jnp.float32)

    @jax.jit
    @jax.vmap
    def look_up(nav, xy):
        drawn = task.drawn_maze(table, nav)
        is_wall = jax.vmap(maze_lib.is_wall, (None, 0))(drawn, xy)
        goal = jax.vmap(maze_lib.goal_at, (None, 0))(drawn, xy)
        return task.code_at(table, nav, xy), is_wall, goal

    codes, is_wall, goal = map(np.asarray, look_up(nav, xy))
    assert ((codes == maze_lib.WALL) == is_wall).all()
    assert (np.where(is_wall, 0, codes) == goal).all()


def test_a_goal_pays_once_in_any_order_and_the_last_terminates():
    table = task.prepare(mazes.load("s"))
    nav = at(table)
    third, first, second = centre(7, 15)[None], centre(6, 5)[None], centre(2, 10)[None]
    rewards, ends = [], []
    for path in (third, third, centre(1, 1)[None], jnp.concatenate([first, first]), second):
        nav, outcome = advance(table, nav, path)
        rewards.append(float(outcome.reward))
        ends.append(bool(outcome.terminated))
        assert not outcome.truncated
    assert rewards == [1.0, 0.0, 0.0, 1.0, 1.0]
    assert ends == [False] * 4 + [True]
    assert (nav.decisions, task.success(table, nav)) == (5, 1.0)


def test_goals_are_paid_along_the_way():
    table = task.prepare(mazes.load("s"))
    path = jnp.stack([centre(6, 4), centre(6, 5), centre(6, 6), centre(2, 10), centre(3, 11)])
    nav, outcome = advance(table, at(table), path)
    assert outcome.reward == 2.0
    assert task.success(table, nav) == pytest.approx(2 / 3)


def test_the_time_limit_truncates_unless_the_last_decision_succeeds():
    table = task.prepare(mazes.load("g1"))
    nav = at(table, decisions=jnp.int32(22))
    nav, outcome = advance(table, nav, centre(1, 1)[None])
    assert not (outcome.terminated | outcome.truncated)
    _, outcome = advance(table, nav, centre(1, 1)[None])
    assert (outcome.terminated, outcome.truncated) == (False, True)
    _, outcome = advance(table, nav, centre(0, 5)[None])
    assert (outcome.terminated, outcome.truncated) == (True, False)


def test_dense_reward_is_that_of_the_lowest_unvisited_goal():
    table = task.prepare(mazes.load("s"))
    nav = at(table)
    xy = centre(6, 1) + jnp.array([0.0, -1.5])  # level with goal 1's centre, 12 units away
    assert dense_reward(table, nav, xy) == pytest.approx(1 / 13)
    nav = nav.replace(visited=jnp.arange(9) == 0)
    distance = np.hypot(9 * 3.0, 5.0 * 3.0)
    assert dense_reward(table, nav, xy) == pytest.approx(1 / (1 + distance))
    nav = nav.replace(visited=jnp.arange(9) != 1)
    assert dense_reward(table, nav, xy) == pytest.approx(1 / (1 + distance))
    assert dense_reward(table, nav.replace(visited=jnp.arange(9) < 3), xy) == 1.0


def test_after_nine_goals_the_last_one_stays_the_current():
    table = task.prepare(mazes.parse("############\n#S123456789#\n############\n"))
    for num_visited, column in ((0, 2), (8, 10), (9, 10)):
        nav = at(table, visited=jnp.arange(9) < num_visited)
        told = current_goal_xy(table, nav, centre(1, 1))
        np.testing.assert_array_equal(told, centre(1, column))


@pytest.mark.parametrize(
    ("text", "places"),
    [
        # Its middle is in a wall, in a free cell, and in one of three parts.
        ("#######\n#1.#.1#\n#..S..#\n#######\n", {(1, 2): (1, 1), (2, 3): (1, 1), (2, 4): (1, 5)}),
        ("#####\n#111#\n#1.1#\n#1S1#\n#####\n", {(2, 2): (1, 2), (3, 2): (3, 1)}),
        ("#######\n#1S1.1#\n#######\n", {(1, 2): (1, 1), (1, 4): (1, 3)}),
    ],
)
def test_a_region_in_parts_is_where_its_nearest_cell_is(text, places):
    table = task.prepare(mazes.parse(text))
    assert table.goal_xy.shape[2] > 1
    for here, there in places.items():
        told = current_goal_xy(table, at(table), centre(*here))
        np.testing.assert_array_equal(told, centre(*there))
        distance = np.linalg.norm(np.subtract(here, there)) * base.CELL
        paid = dense_reward(table, at(table), centre(*here))
        assert paid == pytest.approx(1 / (1 + distance))


def test_the_dense_task_goes_on_after_the_last_goal_and_pays_in_full():
    table = task.prepare(mazes.load("u", num_decisions=2))
    there_and_back = jnp.stack([centre(1, 1), centre(7, 1)])
    assert advance(table, at(table), there_and_back)[1].terminated
    nav, outcome = advance(table, at(table), there_and_back, reward="dense")
    assert (outcome.reward, outcome.terminated, outcome.truncated) == (1.0, False, False)
    assert advance(table, nav, centre(7, 1)[None], reward="dense")[1].truncated


def test_dense_reward_of_a_door_and_its_least_value_in_the_random_square():
    table = task.prepare(mazes.load("random"))
    nav = at(table, door_ij=jnp.array([0, 7]))
    assert dense_reward(table, nav, centre(0, 7)) == 1.0
    # Paper, App. D.2: about 0.03 at least.
    assert dense_reward(table, nav, centre(7, 1)) == pytest.approx(0.035, abs=2e-3)


def test_the_picture_is_that_of_the_drawn_maze():
    table = task.prepare(SEVEN)
    view = raster.View()
    nav, xy = starts(table, 30)
    silhouette = jnp.asarray(np.random.default_rng(0).random((15, 15)) < 0.1)

    def both(nav, xy):
        drawn = task.drawn_maze(table, nav)
        expected = pictures.patch(drawn, xy, nav.visited, silhouette, view)
        return task.observe(table, nav, xy, raster.pack(silhouette, view), view), expected

    seen, expected = jax.jit(jax.vmap(both))(nav, xy)
    assert (seen == expected).all()


def test_pick_stays_in_range():
    for num in (1, 3, 4096):
        last = task.pick(jnp.float32(np.nextafter(np.float32(1), np.float32(0))), jnp.int32(num))
        assert last == num - 1
        assert task.pick(jnp.float32(0.0), jnp.int32(num)) == 0


MAP = raster.View(extent=9.0, pixels=15, map_radius=3)


def test_the_map_shows_what_has_been_in_sight_and_nothing_else():
    table = task.prepare(mazes.load("g1"), MAP.margin)
    silhouette = jnp.zeros((15, 1), jnp.uint32)
    nav = look(table, at(table), centre(7, 2), MAP)
    chart = np.asarray(observe(table, nav, centre(7, 2), silhouette, MAP))
    assert chart.shape == MAP.obs_shape == (7, 7, 4)
    wall, goal, robot, unseen = np.moveaxis(chart, -1, 0)
    assert np.argwhere(robot).tolist() == [[3, 3]]
    # Row 7, column 2: three by three cells in sight, the outer wall in row 8.
    expected = np.ones((7, 7), bool)
    expected[2:5, 2:5] = False
    np.testing.assert_array_equal(unseen, expected)
    assert np.argwhere(wall).tolist() == [[4, 2], [4, 3], [4, 4]]
    assert not goal.any()
    # One cell to the north: what was seen moves down on the map and stays on it.
    nav = look(table, nav, centre(6, 2), MAP)
    wall, _, _, unseen = np.moveaxis(
        np.asarray(observe(table, nav, centre(6, 2), silhouette, MAP)), -1, 0
    )
    assert np.argwhere(wall).tolist() == [[2, 4], [5, 2], [5, 3], [5, 4]]
    assert not unseen[2:6, 2:5].any() and unseen.sum() == 49 - 12


def test_a_view_off_the_middle_of_a_cell_touches_a_fourth_column():
    shape, margin = (9 + 6, 9 + 6), 3
    seen = raster.in_sight(shape, margin, centre(4, 4) + jnp.array([0.2, 0.0]), MAP)
    assert np.argwhere(np.asarray(seen).any(0)).ravel().tolist() == [6, 7, 8, 9]
    assert np.argwhere(np.asarray(seen).any(1)).ravel().tolist() == [6, 7, 8]


def test_the_map_shows_the_open_door_until_it_is_paid_and_walls_beyond_the_grid():
    table = task.prepare(mazes.load("random"), MAP.margin)
    silhouette = jnp.zeros((15, 1), jnp.uint32)
    nav = at(table, door_ij=jnp.array([1, 8]))
    nav = look(table, nav, centre(1, 7), MAP)
    chart = observe(table, nav, centre(1, 7), silhouette, MAP)
    assert np.argwhere(np.asarray(chart[..., 1])).tolist() == [[3, 4]]
    assert np.asarray(chart[..., 0]).sum() == 4  # three in the north, one beside the door
    paid = nav.replace(visited=nav.visited.at[0].set(True))
    assert not observe(table, paid, centre(1, 7), silhouette, MAP)[..., 1].any()
    beyond = look(table, nav, centre(0, 8), MAP)
    chart = np.asarray(observe(table, beyond, centre(0, 8), silhouette, MAP))
    assert chart[2, 3, 0] and chart[2, 4, 0]


def test_a_map_of_several_mazes_is_that_of_the_episode_s_maze():
    table = task.prepare(SEVEN, MAP.margin)
    silhouette = jnp.zeros((15, 1), jnp.uint32)
    for maze in range(7):
        alone = task.prepare(mazes.load(mazes.NAMES[maze]), MAP.margin)
        for ij in ((1, 1), (7, 2), (4, 6)):
            charts = []
            for some, number in ((table, maze), (alone, 0)):
                nav = look(some, at(some, maze=jnp.int32(number)), centre(*ij), MAP)
                charts.append(observe(some, nav, centre(*ij), silhouette, MAP))
            np.testing.assert_array_equal(*charts)


@pytest.mark.parametrize("knows", ["nothing", "goal", "map"])
def test_the_map_of_a_whole_maze_holds_that_around_the_robot_and_what_is_known(knows):
    maze, silhouette = mazes.load("random"), jnp.zeros((15, 1), jnp.uint32)
    around = dataclasses.replace(MAP, knows=knows)
    whole = around.covering(9, 9)
    charts = []
    for view in (around, whole):
        table = task.prepare(maze, view.margin)
        nav = at(table, door_ij=jnp.array([1, 8]))
        for ij in ((4, 5), (4, 4)):
            nav = look(table, nav, centre(*ij), view)
        charts.append(np.asarray(observe(table, nav, centre(4, 4), silhouette, view)))
        assert charts[-1].shape == view.obs_shape

    # Eight cells beyond the maze on each side, so the robot's is (12, 12).
    first, last = 4 + 8 - 3, 4 + 8 + 3
    np.testing.assert_array_equal(charts[0], charts[1][first : last + 1, first : last + 1])
    wall, goal, robot, unseen = np.moveaxis(charts[1], -1, 0)
    assert np.argwhere(robot).tolist() == [[12, 12]]
    assert np.argwhere(goal).tolist() == ([] if knows == "nothing" else [[9, 16]])
    assert unseen.sum() == {"nothing": 25 * 25 - 12, "goal": 25 * 25 - 13, "map": 0}[knows]
    assert wall.any() == (knows == "map")


def test_what_is_known_needs_a_map():
    with pytest.raises(base.UserError, match="knows = 'goal' needs a map, but map_radius = 0"):
        raster.View(knows="goal")


def test_a_free_candidate_is_drawn_as_the_goal_and_never_as_the_start_beside_it():
    maze = mazes.parse("######\n#S**G#\n#....#\n######")
    table = task.prepare(maze)
    navs, xy = starts_of(table, jax.random.split(jax.random.key(0), 900))
    goals = [tuple(ij) for ij in np.asarray(navs.door_ij).tolist()]
    starts = [tuple(ij) for ij in np.asarray(jax.vmap(maze_lib.cell_ij)(xy)).tolist()]
    pairs = collections.Counter(zip(goals, starts, strict=True))
    # Three goals, each with the starts that are left: two beside a `*`, three beside the `G`.
    expected = {
        (g, (1, s)): 300 / (2 if g[1] < 4 else 3)
        for g in [(1, 2), (1, 3), (1, 4)]
        for s in (1, 2, 3)
        if s != g[1]
    }
    assert pairs.keys() == expected.keys()
    assert all(abs(pairs[pair] - num) < 50 for pair, num in expected.items())
    drawn = task.drawn_maze(table, jax.tree.map(lambda leaf: leaf[0], navs))
    assert (drawn.wall == maze.wall).all() and drawn.goal[goals[0]] == 1 and drawn.goal.sum() == 1
