"""Robots whose description promises what a simulation denies, and walls that hold fast ones."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.envs import goal_maze, task
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import engines, kinematics, scene, walls
from eihrl_jax.robots import robot as robot_lib

PUCK = """<mujoco model="puck">
  <default><geom contype="1" conaffinity="0"/></default>
  <worldbody><body name="puck" pos="0 0 0.6">
    <joint name="x" type="slide" axis="1 0 0" damping="{damping}"/>
    <joint name="y" type="slide" axis="0 1 0" damping="{damping}"/>
    <geom type="sphere" size="0.4" mass="5"/>{more}
  </body></worldbody>
  <actuator><motor joint="x" gear="{gear}" ctrlrange="-1 1"/>
    <motor joint="y" gear="{gear}" ctrlrange="-1 1"/></actuator>
</mujoco>"""
ARM = '<geom type="capsule" fromto="-2 0 0 2 0 0" size="0.1" mass="0.5"/>'


def _puck(tmp_path, *, gear=30, damping=10, more="", **options):
    path = tmp_path / "puck.xml"
    path.write_text(PUCK.format(gear=gear, damping=damping, more=more))
    numbers = {"physics_step": 0.01, "num_substeps": 10, "steps_per_subgoal": 12}
    sizes = {"reach": 0.4, "body_radius": 0.4}
    return robot_lib.Robot(name="puck", mjcf=path, root="slide", **numbers | sizes | options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"more": ARM},
            "parts come 2.10 m far from its torso: reach must be 2.10",
        ),
        ({"more": ARM, "cell": 2.0}, "it needs a cell of more than 2.10"),
        (
            {"gear": 1500, "damping": 100},
            "15.0 m/s, and walls hold up to 11.0: say max_speed = ",
        ),
        ({"gear": 6000, "damping": 100}, "0.60 m in a physics step, farther than its body_radius"),
        ({"gear": 1e308}, "its simulation breaks down at full power: take a smaller physics_step"),
        ({"max_speed": 26.5}, "max_speed = 26.5 moves the torso 2.65 m in a control step"),
    ],
)
def test_what_walls_would_not_hold_is_refused(tmp_path, options, message):
    with pytest.raises(base.UserError, match=re.escape(message)) as error:
        engines.make(_puck(tmp_path, **options))
    assert "\n" not in str(error.value)


def test_walls_hold_the_fastest_robot_that_is_allowed(tmp_path):
    """A puck of 25 m/s, 2.5 units in a control step, driven against walls of every kind."""
    robot = _puck(tmp_path, gear=2500, damping=100, max_speed=25.5)
    assert robot.num_walls == 8
    maze = mazes.load("g2")
    env = goal_maze.GoalMaze(engines.make(robot), maze)

    def run(key):
        ctrls = jax.random.choice(key, jnp.array([-1.0, 1.0]), (12, 2))

        def step(state, ctrl):
            state = env.step(state, ctrl)
            return state, state.inner.physics.qpos

        return jax.lax.scan(step, env.reset(key), jnp.repeat(ctrls, 5, 0))[1]

    xy = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 32)).reshape(-1, 2)
    assert not jax.vmap(maze_lib.is_wall, in_axes=(None, 0))(maze, xy).any()
    assert jnp.abs(jnp.diff(xy, axis=0)).max() > 2.0


@pytest.mark.parametrize("change", [{"qvel": 2e4}, {"qvel": 60.0}])
def test_a_simulation_beyond_any_sense_ends_the_episode(tmp_path, change):
    """Spinning at 20,000 radians a second, or as far as walls could not follow in one step."""
    robot = robots.load("ant")
    env = goal_maze.GoalMaze(engines.make(robot), mazes.load("u"))
    state = jax.jit(env.reset)(jax.random.key(0))
    physics = state.inner.physics
    which = 9 if change["qvel"] > 100.0 else 0
    fast = physics.replace(qvel=physics.qvel.at[which].set(change["qvel"]))
    after = jax.jit(env.step)(state.replace(inner=state.inner.replace(physics=fast)), jnp.zeros(8))
    assert after.terminated and after.metrics["broke_down"] == 1.0
    np.testing.assert_array_equal(after.inner.physics.qpos, physics.qpos)


@pytest.mark.parametrize(
    ("name", "maze"), [("swimmer", "u"), ("swimmer", "cell"), ("ant", "random")]
)
def test_no_robot_starts_in_a_wall(name, maze):
    """Nor is it thrown out of one, by which goals have been paid without any control."""
    engine = engines.make(robots.load(name))
    room = mazes.parse("####\n#S1#\n####", name="cell") if maze == "cell" else mazes.load(maze)
    env = goal_maze.GoalMaze(engine, room)
    to_capsules = kinematics.capsules(engine.model)

    def start(key):
        state = env.reset(key)
        before = state.inner.physics.qpos
        after = env.step(state, jnp.zeros(engine.model.nu)).inner.physics.qpos
        drawn = task.drawn_maze(env.table, state.inner.nav)
        depth = walls.depth(drawn, before[:2], to_capsules(before))
        return depth, jnp.abs(after[:2] - before[:2]).max()

    keys = jax.random.split(jax.random.key(1), 100)
    depth, moved = jax.jit(jax.vmap(start))(keys)
    assert float(depth.max()) <= 1e-6 and float(moved.max()) < 0.2


def test_depth_in_walls_is_that_of_the_deepest_part():
    maze = mazes.parse("####\n#S1#\n####")
    start = jnp.array([[4.5, -4.5, 0.5], [4.5, -4.5, 0.5]])
    end = jnp.array([[4.5, -5.5, 0.5], [4.5, -4.5, 0.5]])
    radius = jnp.array([0.7, 0.3])
    found = walls.depth(maze, jnp.array([4.5, -4.5]), (start, end, radius))
    assert float(found) == pytest.approx(0.2, abs=1e-5)  # its end is half a unit from the wall


def test_a_changed_robot_has_another_fingerprint(tmp_path):
    robot = _puck(tmp_path)
    before = scene.fingerprint(scene.build(robot), robot)
    assert before == scene.fingerprint(scene.build(robot), robot)
    slower = dataclasses.replace(robot, steps_per_subgoal=13)
    heavier = _puck(tmp_path, more='<geom size="0.1" mass="0.1"/>')
    for other in (slower, heavier):
        assert scene.fingerprint(scene.build(other), other) != before
