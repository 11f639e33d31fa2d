import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.mazes import generators, parsing, paths


@pytest.mark.parametrize("seed", range(100))
def test_every_door_can_be_reached_from_every_start(seed):
    rows, columns = np.random.default_rng(seed).integers(1, 16, 2).tolist()
    share = 0.4 * (seed % 5) / 4
    maze = generators.random_maze(seed, rows, columns, wall_share=share)  # parsing checks the ways
    assert maze.wall.shape == (rows + 2, columns + 2)
    starts, doors = paths.cells(np.asarray(maze.start)), paths.cells(np.asarray(maze.door))
    assert 1 <= len(doors) <= 4
    assert not set(starts) & set(doors)
    assert all(1 <= paths.arrivals(maze, starts[-1], door)[0] <= rows * columns for door in doors)


def test_goals_lie_at_every_place_that_can_be_reached_and_starts_elsewhere():
    maze = parsing.parse("######\n#SS..#\n#D##.#\n#..###\n######\n")
    variants = generators.goals_anywhere(maze)
    goals = [paths.cells(np.asarray(goal) > 0) for goal in variants.goal]
    # Not beyond the door, which is opened where it is the goal.
    assert goals == [[(1, 1)], [(1, 2)], [(1, 3)], [(1, 4)], [(2, 4)], [(2, 1)]]
    starts = [paths.cells(np.asarray(start)) for start in variants.start]
    assert starts == [[(1, 2)], [(1, 1)], *[[(1, 1), (1, 2)]] * 4]
    assert not (np.asarray(variants.wall) & (np.asarray(variants.goal) > 0)).any()
    assert np.asarray(variants.wall)[:5, 2, 1].all() and not np.asarray(variants.door).any()


def test_a_single_start_is_no_goal():
    variants = generators.goals_anywhere(parsing.parse("#####\n#S.1#\n#####\n"))
    assert [paths.cells(np.asarray(goal) > 0) for goal in variants.goal] == [[(1, 2)], [(1, 3)]]


def test_goals_anywhere_need_a_maze_of_moderate_size():
    room = "\n".join(["#" * 35, *["#" + "S" * 33 + "#"] * 32, "#" + "S" * 32 + "1#", "#" * 35])
    with pytest.raises(base.UserError, match="1089 places, must be at most 1000"):
        generators.goals_anywhere(parsing.parse(room))


def test_rooms_have_inner_walls_of_about_the_share_asked_for():
    def share(wall_share: float) -> float:
        rooms = [generators.random_room(s, 20, 20, wall_share=wall_share) for s in range(10)]
        return np.mean([room.count("#") + room.count("D") - 84 for room in rooms]) / 400

    assert share(0.0) == 0.0
    assert 0.15 < share(0.2) < 0.25
    assert share(0.1) < share(0.3)


def test_the_seed_decides_the_room():
    assert generators.random_room(1, 9, 9) == generators.random_room(1, 9, 9)
    assert len({generators.random_room(seed, 9, 9) for seed in range(20)}) == 20


def test_number_of_doors_and_size_limits():
    assert generators.random_room(0, 7, 7, wall_share=0.0, num_doors=1000).count("D") == 28
    assert generators.random_room(0, 7, 7, num_doors=1).count("D") == 1
    largest = parsing.parse(generators.random_room(0, 254, 3))
    assert largest.wall.shape == (256, 5)


@pytest.mark.parametrize(
    ("option", "value"),
    [("seed", -1), ("rows", 0), ("columns", 255), ("wall_share", 0.5), ("num_doors", 0)],
)
def test_arguments_out_of_range(option, value):
    arguments = {"seed": 0, "rows": 5, "columns": 5} | {option: value}
    with pytest.raises(base.UserError, match=f"{option} = {value}"):
        generators.random_room(**arguments)


def test_rooms_to_train_in_are_of_all_sizes_and_none_is_a_room_of_a_small_seed():
    rooms = generators.training_rooms(3, 40, sides=(5, 8), wall_share=0.3)
    shapes = {room.wall.shape for room in rooms}
    assert (
        {rows - 2 for rows, _ in shapes} == {columns - 2 for _, columns in shapes} == {5, 6, 7, 8}
    )
    again = generators.training_rooms(3, 40, sides=(5, 8), wall_share=0.3)
    others = generators.training_rooms(4, 40, sides=(5, 8), wall_share=0.3)
    texts = [[np.asarray(room.wall).tobytes() for room in lot] for lot in (rooms, again, others)]
    assert texts[0] == texts[1]
    assert len(set(texts[0]) & set(texts[2])) < 3
    limited = generators.training_rooms(0, 2, sides=(5, 5), wall_share=0.0, num_decisions=17)
    assert [int(room.num_decisions) for room in limited] == [17, 17]
    with pytest.raises(base.UserError, match="num = 0"):
        generators.training_rooms(0, 0, sides=(5, 5), wall_share=0.0)
