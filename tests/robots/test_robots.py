"""Every robot loads, settles, steps without exploding on both engines, and is as it says it is."""

import dataclasses
import pathlib
import re

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.physics import controls, engines, kinematics, scene
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.robots import symmetry

NUM = 4


def roll(engine, ctrls):
    """Steps copies of the robot from its standing posture; returns qpos and qvel [T, N, ...]."""
    model = engine.model
    start = np.tile(model.key_qpos[0], (ctrls.shape[1], 1))
    start = jax.vmap(engine_lib.reset)(jnp.asarray(start), jnp.zeros((len(start), model.nv)))
    walls_xy = np.full((len(start.qpos), engine.robot.num_walls, 2), scene.PARKED_XY, np.float32)

    def step(state, ctrl):
        state = jax.vmap(engine.step)(state, ctrl, jnp.asarray(walls_xy))
        return state, (state.qpos, state.qvel)

    rolled = jax.jit(lambda s, u: jax.lax.scan(step, s, u)[1])(start, jnp.asarray(ctrls))
    return jax.tree.map(np.asarray, rolled)


def ctrls_of(engine, num_steps, kind):
    shape = (num_steps, NUM, engine.model.nu)
    drawn = np.random.default_rng(0).choice([-1.0, 1.0], shape)
    return (drawn if kind == "random" else np.zeros(shape)).astype(np.float32)


CART = pathlib.Path(__file__).parents[2] / "docs" / "robots" / "cart.toml"


def test_names():
    assert all(robots.load(name).name == name for name in robots.NAMES)
    with pytest.raises(base.UserError, match=r"robot 'cheetah' is unknown; choose one of point, "):
        robots.load("cheetah")


@pytest.mark.parametrize("name", robots.NAMES)
def test_description_fits_the_model(name):
    robot = robots.load(name)
    model = scene.build(robot)
    taken = controls.of(model, robot)
    half = 1.0 if robot.servo_range is None else robot.servo_range
    np.testing.assert_allclose(taken.high - taken.low, 2 * half, rtol=1e-6)
    first = mujoco.mjtJoint(model.jnt_type[0])
    assert model.body(1).name == "torso"
    if robot.root == "free":
        assert first == mujoco.mjtJoint.mjJNT_FREE
    else:
        assert first == mujoco.mjtJoint.mjJNT_SLIDE
        np.testing.assert_array_equal(model.jnt_axis[:2], [[1, 0, 0], [0, 1, 0]])
    low, high = model.jnt_range.T
    stand = model.key("stand").qpos
    for joint in np.flatnonzero(model.jnt_limited):
        assert low[joint] <= stand[model.jnt_qposadr[joint]] <= high[joint]


@pytest.mark.parametrize("name", robots.NAMES)
def test_no_part_is_farther_than_reach(name):
    """Random postures, joints at their limits among them."""
    robot = robots.load(name)
    model = scene.build(robot)
    rng = np.random.default_rng(0)
    qpos = np.tile(model.key_qpos[0], (1000, 1))
    for joint in np.flatnonzero(model.jnt_limited):
        low, high = model.jnt_range[joint]
        drawn = np.clip(rng.uniform(2 * low - high, 2 * high - low, 1000), low, high)
        qpos[:, model.jnt_qposadr[joint]] = drawn
    if robot.root == "free":
        qpos[:, 3:7] = rng.normal(size=(1000, 4))
    start, end, radius = jax.jit(jax.vmap(kinematics.capsules(model)))(
        jnp.asarray(qpos, jnp.float32)
    )
    ends = np.stack([start, end])[..., :2]
    farthest = (np.linalg.norm(ends, axis=-1) + np.asarray(radius)).max()
    assert 0.9 * robot.reach < farthest <= robot.reach + 1e-6


@pytest.mark.parametrize("name", robots.NAMES)
@pytest.mark.parametrize("kind", ["still", "random"])
def test_steps_stably(name, kind):
    """300 control steps without nan or absurd speeds; still robots come to rest."""
    engine = engines.make(robots.load(name))
    qpos, qvel = roll(engine, ctrls_of(engine, 300, kind))
    assert np.isfinite(qpos).all()
    assert np.abs(qvel).max() < 60.0
    if kind == "still":
        assert np.abs(qvel[-1]).max() < 0.05
        assert np.abs(qpos[-1, :, :2]).max() < 1.0
    else:
        assert np.abs(qvel[-1]).max() > 0.05


@pytest.mark.parametrize("name", ["ant", "go1"])
def test_quadrupeds_settle_on_their_feet(name):
    engine = engines.make(robots.load(name))
    qpos, _ = roll(engine, ctrls_of(engine, 200, "still"))
    low, high = engine.robot.healthy_z
    assert low < qpos[-1, 0, 2] < high


def test_humanoid_stands_then_falls_without_control():
    engine = engines.make(robots.load("humanoid"))
    qpos, _ = roll(engine, ctrls_of(engine, 120, "still"))
    low, high = engine.robot.healthy_z
    assert (qpos[:8, :, 2] > low).all() and (qpos[:8, :, 2] < high).all()
    assert (qpos[-1, :, 2] < 0.5).all()


def test_point_reaches_its_terminal_speed():
    """8 N against a damping of 4 N s/unit: 2 units/s, the same in every direction."""
    engine = engines.make(robots.load("point"))
    ctrls = np.zeros((20, NUM, 2), np.float32)
    ctrls[:] = [[1, 0], [-1, 0], [0, 1], [0, -1]]
    _, qvel = roll(engine, ctrls)
    np.testing.assert_allclose(qvel[-1], 2.0 * ctrls[-1], atol=0.01)


def test_swimmer_swims():
    """Bending in turns moves it along; at rest the water stops it. No floor holds it."""
    engine = engines.make(robots.load("swimmer"))
    t = np.arange(300) * engine.robot.control_step
    wave = np.stack([np.sin(2.0 * t), np.sin(2.0 * t - np.pi / 2)], 1)
    ctrls = np.tile(wave[:, None], (1, NUM, 1)).astype(np.float32)
    qpos, _ = roll(engine, ctrls)
    assert np.linalg.norm(qpos[-1, 0, :2]) > 1.0


def test_swimmer_is_stopped_by_a_wall():
    engine = engines.make(robots.load("swimmer"))
    walls_xy = np.full((8, 2), scene.PARKED_XY, np.float32)
    walls_xy[0] = (4.0, 0.0)
    state = engine_lib.reset(jnp.zeros(5), jnp.zeros(5).at[0].set(3.0))
    for _ in range(10):
        state = engine.step(state, jnp.zeros(2), jnp.asarray(walls_xy))
    nose = state.qpos[0] + 1.5 + 0.1
    assert 2.3 < nose < 2.6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["point", "swimmer", "humanoid", "go1"])
def test_mjx_agrees_on_the_other_robots(name):
    """Ten control steps with random controls; the ant's comparison is in tests/physics."""
    robot = robots.load(name)
    c_engine, mjx_engine = (engines.make(robot, engine) for engine in base.ENGINES)
    ctrls = ctrls_of(c_engine, 10, "random")
    truth, _ = roll(c_engine, ctrls)
    qpos, _ = roll(mjx_engine, ctrls)
    np.testing.assert_allclose(qpos, truth, atol=5e-3)


def _changed(tmp_path, old, new, in_xml=False):
    """A copy of the example's files in which one text is another."""
    for suffix in (".toml", ".xml"):
        text = CART.with_suffix(suffix).read_text()
        if (suffix == ".xml") == in_xml:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / f"cart{suffix}").write_text(text)
    return str(tmp_path / "cart.toml")


def test_a_robot_of_ones_own_moves_and_meets_walls():
    robot = robots.load(str(CART))
    engine = engines.make(robot, "mujoco")
    step = jax.jit(engine.step)
    walls_xy = jnp.tile(jnp.array(scene.PARKED_XY), (robot.num_walls, 1))
    state = engine_lib.reset(jnp.zeros(3), jnp.zeros(3))
    for _ in range(30):
        state = step(state, jnp.array([1.0, 0.0]), walls_xy)
    assert 3.0 < float(state.qpos[0]) < 9.0 and abs(float(state.qpos[1])) < 1e-3
    walls_xy = walls_xy.at[0].set(jnp.array([3.5, 0.0]))  # its face is at x = 2
    state = engine_lib.reset(jnp.zeros(3), jnp.zeros(3))
    for _ in range(30):
        state = step(state, jnp.array([1.0, 0.0]), walls_xy)
    # The mast, which alone has contype 4, reaches 0.72 units ahead; the hull 0.75.
    assert 1.2 < float(state.qpos[0]) < 1.3


@pytest.mark.parametrize(
    ("old", "new", "in_xml", "message"),
    [
        ('"planar"', '"wheeled"', False, "root = 'wheeled' must be one of free, planar, slide"),
        (
            "reach = 0.9",
            "reach = 9.0",
            False,
            "reach = 9.0 must be at most 3.0 and greater than 0.0",
        ),
        ("reach = 0.9", "", False, "argument: 'reach'"),
        ("reach = 0.9", "wings = 2", False, "unknown option 'wings'"),
        ("reach = 0.9", "reach = nine", False, "is no TOML"),
        ('"cart"', '"ant"', False, "name 'ant' is taken by the package"),
        ("[1, -2]", "[1, 1]", False, "mirror_controls = (1, 1) must hold each of 1 to 2 once"),
        ("[1, -2]", "[1, -2, 3]", False, "symmetry orders 3 controls, it has 2"),
        ("cart.xml", "lorry.xml", False, "lorry.xml"),
        ("<mujoco", "<mujok", True, "cart.xml"),
        (
            "[1, -2]",
            "[2, 1]\nnum_turns = 2\nturn_controls = [2, -1]",
            False,
            "2 turns aren't the identity",
        ),
        ("[1, -2]", "[2, -1]", False, "two reflections aren't the identity"),
        (
            "mirror_joints",
            "turn_controls = [1, 2]\nmirror_joints",
            False,
            "needs num_turns above 1",
        ),
        ('"planar"', '"slide"', False, "its first two actuators must push along x and y"),
        ('axis="0 1 0"', 'axis="0 0 1"', True, "must slide along x and y"),
        ('axis="0 0 1" damping="8"', 'axis="1 0 0"', True, "and turn about z"),
        (
            'ctrllimited="true"',
            'ctrllimited="false"',
            True,
            "actuator 'push' has no range: give it a ctrlrange",
        ),
        ("<site", '<body><joint type="ball"/><geom size="0.1"/></body><site', True, "hinges and"),
        ('type="hinge"', 'type="slide"', True, "aren't those of root 'planar'"),
        ('<motor name="push"', '<general dyntype="integrator" name="push"', True, "has a state"),
        (
            '"torso" pos="0 0 0.5"',
            '"torso" euler="0 0 90"',
            True,
            "must be neither turned nor moved",
        ),
        ('damping="8"', 'damping="8" pos="0.2 0 0"', True, "must be neither turned nor moved"),
        ('type="capsule" fromto', 'size="inf" fromto', True, "cart.xml"),
        ("reach = 0.9", 'reach = 0.9\nkeyframe = "run"', False, "keyframe = 'run' isn't in it"),
        # A value of any length is no more than a line or two of the message.
        ("reach = 0.9", f'reach = 0.9\nkeyframe = "{"x" * 5000}"', False, "isn't in it; there is"),
        ("reach = 0.9", "reach = 0.9\nstart = [0.0]", False, "start has 1 numbers, its qpos has 3"),
    ],
)
def test_what_is_wrong_with_a_description_is_said(tmp_path, old, new, in_xml, message):
    path = _changed(tmp_path, old, new, in_xml)
    with pytest.raises(base.UserError, match=re.escape(message)) as error:
        scene.build(robots.load(path))
    assert "\n" not in str(error.value) and "robot" in str(error.value)
    assert len(str(error.value)) <= 1000


def test_a_free_root_must_stand_upright(tmp_path):
    ant = robots.load("ant")
    lying = tmp_path / "ant.xml"
    text = ant.mjcf.read_text()
    assert 'qpos="0 0 0.75 1 0 0 0' in text
    text = text.replace('qpos="0 0 0.75 1 0 0 0', 'qpos="0 0 0.75 1 1 0 0')
    lying.write_text(text)
    with pytest.raises(base.UserError, match="its start posture must be upright"):
        scene.build(dataclasses.replace(ant, mjcf=lying))


def test_a_missing_description_is_named():
    with pytest.raises(base.UserError, match=r"robot 'no\.toml': No such file"):
        robots.load("no.toml")


def test_a_sliding_robot_can_be_mirrored_but_not_turned():
    turned = symmetry.Symmetry(num_turns=2, turn_controls=(-1, -2))
    with pytest.raises(base.UserError, match="has no heading to turn"):
        dataclasses.replace(robots.load("point"), symmetry=turned)
