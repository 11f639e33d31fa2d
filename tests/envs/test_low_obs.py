"""What the low level's network sees and does does not depend on the direction, nor on which of the
robot's like sides is called its front."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import robots
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import low_obs
from eihrl_jax.ops import rotations
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene
from eihrl_jax.robots import symmetry as symmetry_lib

POINT, ANT, SWIMMER, HUMANOID, GO1 = (robots.load(name) for name in robots.NAMES)
CART = robots.load(str(pathlib.Path(__file__).parents[2] / "docs" / "robots" / "cart.toml"))
CANONICAL = low_config.LowInput(frame="canonical", use_progress=True)


def _random_obs(robot, num_proprioception, seed=0):
    rng = np.random.default_rng(seed)
    return low_obs.LowObs(
        proprioception=jnp.float32(rng.normal(size=num_proprioception)),
        displacement_xy=jnp.float32(rng.normal(size=2)),
        time_left=jnp.float32(0.4),
        direction=jnp.int32(0),
    )


@pytest.mark.parametrize("robot", [ANT, POINT, SWIMMER], ids=lambda robot: robot.name)
@pytest.mark.parametrize("direction", range(4))
def test_features_do_not_change_when_the_world_turns(robot, direction):
    """A turned robot with a turned subgoal looks the same in the direction's frame."""
    size = {"ant": 27, "point": 2, "swimmer": 8}[robot.name]
    obs = _random_obs(robot, size)
    options = low_config.LowInput(frame="direction", use_progress=True)
    index = jnp.int32(direction)
    proprioception = np.array(obs.proprioception)
    if robot.root == "free":
        proprioception[1:5] /= np.linalg.norm(proprioception[1:5])
        obs = obs.replace(proprioception=jnp.float32(proprioception.copy()))
        # The inverse of a turn by one direction is the turn by its mirror image.
        inverse = jnp.int32((0, 1, 3, 2)[direction])
        quat = rotations.quaternion_to_direction_frame(obs.proprioception[1:5], inverse)
        proprioception[1:5] = quat
    elif robot.root == "planar":
        proprioception[0] += (0.0, np.pi, np.pi / 2, -np.pi / 2)[direction]
    num_qvel = (size + 1) // 2 if robot.root == "free" else (size + 2) // 2
    velocity = slice(size - num_qvel, size - num_qvel + 2)
    proprioception[velocity] = rotations.to_world_frame(obs.proprioception[velocity], index)
    turned = obs.replace(
        proprioception=jnp.float32(proprioception),
        displacement_xy=rotations.to_world_frame(obs.displacement_xy, index),
        direction=index,
    )
    np.testing.assert_allclose(
        low_obs.features(turned, robot, options),
        low_obs.features(obs, robot, options),
        atol=1e-5,
    )


def test_world_features_hold_the_two_hot_code():
    obs = _random_obs(ANT, 27).replace(direction=jnp.int32(2))
    found = low_obs.features(obs, ANT, low_config.LowInput())
    assert found.shape == (27 + 8,)
    np.testing.assert_array_equal(found[27:], [0, 0, 0, 0, 1, 1, 0, 0])


def test_only_joint_velocities_and_spin_are_scaled():
    obs = _random_obs(ANT, 27)
    plain = low_obs.features(obs, ANT, low_config.LowInput())
    scaled = low_obs.features(obs, ANT, low_config.LowInput(velocity_scale=0.1))
    factor = np.ones(35)
    factor[16:27] = 0.1  # after height, quaternion, joints and the torso's velocity
    np.testing.assert_allclose(scaled, factor * plain, rtol=1e-6)


def test_what_a_real_robot_cannot_measure_is_not_seen():
    """Height and velocity of the torso change nothing; its attitude, spin and joints do."""
    size = 1 + 4 + 12 + 6 + 12
    obs = _random_obs(GO1, size)
    options = low_config.LowInput(frame="direction", use_progress=True)
    found = low_obs.features(obs, GO1, options)
    assert found.shape == (4 + 12 + 3 + 12 + 3,)
    changes = [
        (low_obs.features(obs.replace(proprioception=moved), GO1, options) != found).any()
        for moved in obs.proprioception[None] + jnp.eye(size)
    ]
    assert [i for i, seen in enumerate(changes) if not seen] == [0, 17, 18, 19]


@pytest.mark.parametrize("robot", [ANT, POINT], ids=lambda robot: robot.name)
def test_controls_and_actions_undo_each_other(robot):
    options = low_config.LowInput(frame="direction")
    action = jnp.array([0.3, -0.9])
    for direction in range(4):
        index = jnp.int32(direction)
        obs = _random_obs(robot, 27 if robot is ANT else 2).replace(direction=index)
        ctrl = low_obs.ctrl_from_action(action, obs, robot, options)
        back = low_obs.action_from_ctrl(ctrl, obs, robot, options)
        np.testing.assert_allclose(back, action, atol=1e-7)
    is_turned = not np.allclose(ctrl, action)
    assert is_turned == (robot.root == "slide")


def _rename(values, order, signs):
    return signs * np.asarray(values)[order]


def _image(state, robot, variant):
    """Returns the state with the body's axes turned and mirrored at the world's y = 0."""
    qpos, qvel = np.array(state.qpos, np.float64), np.array(state.qvel, np.float64)
    turns, mirrored = variant % robot.symmetry.num_turns, variant >= robot.symmetry.num_turns
    angle = 2 * np.pi * turns / robot.symmetry.num_turns
    order, signs = (table[variant] for table in robot.symmetry.joint_tables())
    if robot.root == "free":
        turn, quat = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), angle)
        mujoco.mju_mulQuat(quat, qpos[3:7], turn)
        spin = complex(*qvel[3:5]) * np.exp(-1j * angle)
        qvel[3:5] = spin.real, spin.imag
        if mirrored:
            quat *= [1, -1, 1, -1]
            qvel[3:6] *= [-1, 1, -1]
        qpos[3:7], num_root = quat, 7
    elif robot.root == "slide":
        num_root = 2
    else:
        qpos[2] += angle
        if mirrored:
            qpos[2] *= -1
            qvel[2] *= -1
        num_root = 3
    if mirrored:
        qpos[1] *= -1
        qvel[1] *= -1
    num_qvel = len(qvel) - len(order)
    qpos[num_root:] = _rename(qpos[num_root:], order, signs)
    qvel[num_qvel:] = _rename(qvel[num_qvel:], order, signs)
    return engine_lib.reset(jnp.float32(qpos), jnp.float32(qvel))


def _observe(state, robot):
    return low_obs.observe(state, jnp.array([0.2, 0.0]), jnp.int32(7), jnp.int32(0), robot)


@functools.cache
def compiled(robot):
    """Engine, features, controls and back to actions of a robot, compiled once for its variants."""
    functions = low_obs.features, low_obs.ctrl_from_action, low_obs.action_from_ctrl
    return engines.make(robot, "mujoco"), *(
        jax.jit(functools.partial(function, robot=robot, options=CANONICAL))
        for function in functions
    )


SYMMETRIC = [
    (robot, variant)
    for robot in (POINT, ANT, SWIMMER, HUMANOID, GO1, CART)
    for variant in range(len(robot.symmetry.joint_tables()[0]))
]


@pytest.mark.parametrize(
    ("robot", "variant"), SYMMETRIC, ids=lambda item: getattr(item, "name", item)
)
def test_renaming_and_stepping_commute(robot, variant):
    """Physics itself says that the tables are right, on the floor, with joints off their zeros."""
    engine, features, to_ctrl, to_action = compiled(robot)
    near = jnp.tile(jnp.array(scene.PARKED_XY), (robot.num_walls, 1))
    key, ctrl_key = jax.random.split(jax.random.key(variant))
    state = body_lib.draw_pose(engine, jnp.array([0.3, 0.4]), key)
    other = _image(state, robot, variant)
    for action in jax.random.uniform(ctrl_key, (5, engine.model.nu), minval=-1.0, maxval=1.0):
        obs, other_obs = _observe(state, robot), _observe(other, robot)
        np.testing.assert_allclose(features(obs), features(other_obs), atol=2e-3)
        ctrl, other_ctrl = to_ctrl(action, obs), to_ctrl(action, other_obs)
        back = to_action(other_ctrl, other_obs)
        np.testing.assert_allclose(back, action, atol=1e-6)
        state, other = engine.step(state, ctrl, near), engine.step(other, other_ctrl, near)


def test_canonical_bodies_face_the_subgoal():
    """Cosine and sine of the heading stay within an eighth of a turn to the left."""
    for yaw in np.linspace(-3.1, 3.1, 40):
        quat = np.zeros(4)
        mujoco.mju_axisAngle2Quat(quat, np.array([0.0, 0.0, 1.0]), yaw)
        obs = _random_obs(ANT, 27)
        obs = obs.replace(proprioception=obs.proprioception.at[1:5].set(jnp.float32(quat)))
        found = compiled(ANT)[1](obs)
        x, y = rotations.heading(found[1:5])
        assert -1e-6 <= np.arctan2(y, x) <= np.pi / 4 + 1e-6


def test_inverse_tables_undo_renaming():
    for robot in (ANT, SWIMMER, HUMANOID, GO1):
        order, signs = robot.symmetry.control_tables()
        back, back_signs = symmetry_lib.inverse(order, signs)
        values = np.arange(1.0, order.shape[1] + 1)
        for variant in range(len(order)):
            renamed = _rename(values, order[variant], signs[variant])
            found = _rename(renamed, back[variant], back_signs[variant])
            np.testing.assert_array_equal(found, values)
