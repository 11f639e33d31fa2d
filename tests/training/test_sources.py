"""What a run keeps of its maze and its robot, of which it must be made when it goes on."""

import dataclasses

import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import high as high_config
from eihrl_jax.robots import mjcf
from eihrl_jax.training import high, sources

MAZE = "#####\n#S.1#\n#####\n"
DESCRIPTION = """
name = "mine"
mjcf = "robot.xml"
root = "slide"
physics_step = 0.02
num_substeps = 5
steps_per_subgoal = 10
reach = 0.5
body_radius = 0.4
"""


@pytest.fixture
def mine(tmp_path):
    """Returns the description of a robot of one's own, whose model has two files."""
    folder = tmp_path / "robot"
    (folder / "parts").mkdir(parents=True)
    model = robots.load("point").mjcf.read_text()
    option = '<mujocoinclude><option timestep="0.02"/></mujocoinclude>'
    (folder / "parts" / "option.xml").write_text(option)
    include = '<include file="parts/option.xml"/>\n</mujoco>'
    (folder / "robot.xml").write_text(model.replace("</mujoco>", include))
    (folder / "mine.toml").write_text(DESCRIPTION)
    return folder / "mine.toml"


def test_a_robot_is_its_description_and_every_file_of_its_model(mine, tmp_path):
    files = sources.of_robot(str(mine))
    assert sorted(files) == ["parts/option.xml", "robot.toml", "robot.xml"]
    kept = tmp_path / "kept"
    for name, data in files.items():
        (kept / name).parent.mkdir(parents=True, exist_ok=True)
        (kept / name).write_bytes(data)
    assert sources.of_robot(str(kept / "robot.toml")) == files
    assert len(mjcf.files(mine.with_name("robot.xml"))) == 2
    assert sources.of_robot("ant") == {}


def test_a_training_goes_on_in_the_same_maze_alone(mine, tmp_path):
    one, other = tmp_path / "one.txt", tmp_path / "other.txt"
    one.write_text(MAZE)
    other.write_text("\n" + MAZE.replace("\n", "\r\n"))

    def train(maze, **options):
        learner = high_config.Learner(num_workers=2, window=2, num_updates=2)
        config = high_config.HighConfig(
            run=tmp_path / "run",
            task=high_config.Task(maze=str(maze), robot=str(mine)),
            network=high_config.Network(tile_features=2, hidden=(4,)),
            learner=learner,
            log_every=2,
            evaluate_every=2,
            checkpoint_every=2,
            num_eval_episodes=2,
        )
        high.train(dataclasses.replace(config, **options))

    train(one)
    train(other, resume=True)  # the same maze
    one.write_text(MAZE.replace(".", "1"))
    with pytest.raises(base.UserError, match=r"task.maze is not .*: maze.txt differs in line 2"):
        train(one, resume=True)
    (mine.parent / "parts" / "option.xml").write_text("<mujocoinclude><size/></mujocoinclude>")
    with pytest.raises(base.UserError, match=r"task.robot is not .*parts/option.xml differs"):
        train(other, resume=True)


def test_a_maze_by_name_is_kept_as_text():
    (text,) = sources.of_maze(mazes.load("spiral")).values()
    assert text.startswith(b"decisions 200\n")
