import pathlib

import numpy as np
import pytest
from PIL import Image

from eihrl_jax import base, mazes
from eihrl_jax.config import maze as maze_config
from eihrl_jax.reporting import maze_views


def test_a_file_of_another_project_is_shown_drawn_and_saved_as_ours(tmp_path):
    level = tmp_path / "level"
    level.write_text(">.#\n..G\n")
    options = maze_config.MazeConfig(
        file=str(level), picture=tmp_path / "plan.png", save=tmp_path / "ours.txt"
    )
    shown = maze_views.show(options)
    for fact in ("JaxUED level", "4 x 5 cells", "3 moves", "40 decisions", "#S.##\n#..1#"):
        assert fact in shown
    assert np.array_equal(mazes.load(tmp_path / "ours.txt").wall, mazes.load(level).wall)
    with Image.open(tmp_path / "plan.png") as plan:
        assert plan.size[0] > 300
    # Neither file is written over.
    for again in ({"picture": tmp_path / "plan.png"}, {"save": tmp_path / "ours.txt"}):
        with pytest.raises(base.UserError, match="exists"):
            maze_views.show(maze_config.MazeConfig(file=str(level), **again))


def test_start_and_goal_are_chosen_and_a_suite_is_listed(tmp_path):
    (tmp_path / "map").write_text("type octile\nheight 1\nwidth 3\nmap\n...\n")
    options = maze_config.MazeConfig(file=str(tmp_path / "map"), start=(1, 3), goal=(1, 1))
    assert "#1.S#" in maze_views.show(options)
    shown = maze_views.show(maze_config.MazeConfig(file="jaxued"))
    assert "| jaxued-labyrinth | 15 x 15 | 96 | 450 |" in shown
    with pytest.raises(base.UserError, match="jaxued is a suite"):
        maze_views.show(maze_config.MazeConfig(file="jaxued", save=tmp_path / "x"))


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"file": "spiral", "start": (2, 2)}, "'spiral': a maze by name has a start and goal"),
        ({"file": "u", "save": "new.txt", "picture": "link.png"}, "link.png exists"),
        ({"file": "u", "save": "new", "picture": "new"}, "new exists"),
        ({"file": "u", "save": "new.txt", "picture": "absent/p.png"}, "there is no folder absent"),
    ],
)
def test_what_cannot_be_written_is_known_before_anything_is(options, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pathlib.Path("link.png").symlink_to("elsewhere")
    files = {key: pathlib.Path(options[key]) for key in ("save", "picture") if key in options}
    with pytest.raises(base.UserError, match=line):
        maze_views.show(maze_config.MazeConfig(**(options | files)))
    assert [path.name for path in tmp_path.iterdir()] == ["link.png"]


def test_the_name_of_a_file_is_no_formula(tmp_path):
    (tmp_path / "$x_{$.txt").write_text("####\n#S1#\n####\n")
    options = maze_config.MazeConfig(file=str(tmp_path / "$x_{$.txt"), picture=tmp_path / "p.png")
    maze_views.show(options)
    with Image.open(tmp_path / "p.png") as plan:
        assert plan.format == "PNG"
