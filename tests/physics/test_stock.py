"""Robots out of files that were made for another world than a maze: nothing in them is changed."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.physics import controls, engines, kinematics, posture, scene, stock
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.robots import robot as robot_lib

TABLE = """<mujoco model="table">
  <option timestep="0.002" integrator="RK4"><flag contact="disable" clampctrl="disable"/></option>
  <default><geom margin="0.01"/><motor ctrlrange="-3 3"/></default>
  <worldbody>
    <light pos="0 0 3"/><camera name="far" pos="0 0 9"/>
    <geom name="ground" type="plane" size="9 9 1" conaffinity="1"/>
    <geom name="fence" type="box" pos="4 0 1" size="0.1 5 1"/>
    <body name="ball" pos="1 0 0.5"><freejoint/><geom name="ball" size="0.1"/></body>
    <body name="plate" pos="0 0 0.6">
      {root}
      <geom name="plate" type="box" size="0.4 0.2 0.05" mass="4" {plate}/>
      <geom name="flag" size="0.02" pos="0 0 0.3" contype="0" conaffinity="0" mass="0.01"/>
      {legs}
    </body>
  </worldbody>
  <contact>{contact}</contact>
  <actuator>{actuators}</actuator>
  <sensor><framepos objtype="body" objname="ball"/></sensor>
  {keyframe}
</mujoco>"""
LEG = """<body name="leg_{i}" pos="{x} {y} 0">
  <joint name="leg_{i}" axis="0 1 0" range="20 60" limited="true" damping="1"/>
  <geom name="leg_{i}" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.05" {geom}/></body>"""
SERVO = '<position joint="leg_{i}" kp="40" {options}/>'
NUM_POSITIONS = 11


def _table(tmp_path, *, root="<freejoint/>", geom="", contact="", actuators=None, keys="", **to):
    """A plate on four legs in a world of its own, and its description."""
    places = [(0.3, 0.15), (0.3, -0.15), (-0.3, 0.15), (-0.3, -0.15)]
    legs = "".join(LEG.format(i=i, x=x, y=y, geom=geom) for i, (x, y) in enumerate(places))
    motors = actuators or "".join(f'<motor joint="leg_{i}"/>' for i in range(4))
    path = tmp_path / "table.xml"
    path.write_text(
        TABLE.format(
            root=root, plate=geom, legs=legs, contact=contact, actuators=motors, keyframe=keys
        )
    )
    numbers = {"physics_step": 0.005, "num_substeps": 10, "steps_per_subgoal": 50}
    options = {"root": "free", "reach": 1.0, "body_radius": 0.4, **numbers, **to}
    return robot_lib.Robot(name="table", mjcf=path, **options)


def _contypes(model):
    names = ("plate", "flag", "leg_0")
    return {name: int(model.geom(name).contype[0]) for name in names}


@pytest.mark.parametrize(
    ("geom", "contact"),
    [
        ("", ""),
        ('contype="6" conaffinity="5"', ""),
        ('contype="0" conaffinity="1"', ""),
        ('contype="0"  conaffinity="0"', '<pair geom1="plate" geom2="ground"/>'),
        ("", '<pair geom1="plate" geom2="plate"/><exclude body1="plate" body2="ball"/>'),
    ],
)
def test_the_robot_alone_is_left_and_meets_floor_and_walls(tmp_path, geom, contact):
    model = scene.build(_table(tmp_path, geom=geom, contact=contact))
    own = {model.geom(i).name for i in range(model.ngeom)}
    assert {"plate", "flag", "leg_3"} < own and not own & {"ground", "ball", "fence"}
    by_pair = 'contype="0"  ' in geom
    expected = {"plate": stock.BOTH, "flag": 0, "leg_0": 0 if by_pair else stock.BOTH}
    assert _contypes(model) == expected
    is_own = kinematics.local_capsules(model).geom
    assert not model.geom_conaffinity[is_own].any() and not model.geom_margin[is_own].any()
    assert (model.npair, model.nexclude, model.nsensor, model.ncam, model.nlight) == (0,) * 5
    assert not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


def test_without_a_keyframe_it_stands_on_the_floor_with_joints_in_their_ranges(tmp_path):
    model = scene.build(_table(tmp_path))
    start = model.key_qpos[0]
    np.testing.assert_allclose(start[7:], np.deg2rad(20.0))
    assert posture.lowest(model, start) == pytest.approx(0.0, abs=1e-9)
    # The leg's end and the plate's corner; boxes are inside their capsules.
    lengths = np.hypot(0.3, 0.15), 0.4 + np.hypot(0.2, 0.05)
    assert lengths[0] < posture.reach(model, _table(tmp_path)) < 0.9
    assert posture.farthest(model, start) == pytest.approx(lengths[1], abs=0.05)


KEYS = """<keyframe><key name="low" qpos="{ball} 5 6 0.5 1 0 0 0 0.4 0.4 0.4 0.4"/>
  <key name="high" qpos="{ball} 5 6 0.7 1 0 0 0 0.9 0.9 0.9 0.9"/></keyframe>"""


@pytest.mark.parametrize(
    ("options", "height", "joint"),
    [({}, 0.5, 0.4), ({"keyframe": "high"}, 0.7, 0.9)],
)
def test_the_start_posture_is_a_keyframe(tmp_path, options, height, joint):
    # Without the ball, which has numbers in every keyframe.
    robot = _table(tmp_path, keys=KEYS.format(ball=""), **options)
    text = robot.mjcf.read_text().replace('<freejoint/><geom name="ball"', '<geom name="ball"')
    robot.mjcf.write_text(text)
    start = scene.build(robot).key_qpos[0]
    np.testing.assert_allclose(start[[0, 1, 2, 7]], [0.0, 0.0, height, joint])


def test_the_start_posture_is_the_descriptions(tmp_path):
    start = (9.0, 9.0, 0.65, 1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.6, 0.6)
    model = scene.build(_table(tmp_path, start=start))
    np.testing.assert_allclose(model.key_qpos[0], (0.0, 0.0, *start[2:]))


@pytest.mark.parametrize(
    "root",
    [
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint/>',
        "",
        "<joint/>",
    ],
)
def test_a_free_root_replaces_any_other(tmp_path, root):
    model = scene.build(_table(tmp_path, root=root))
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE and model.nq == NUM_POSITIONS


def test_what_slides_is_held_by_walls_alone(tmp_path):
    """Limits, springs and references of the root are gone, and nothing drags on the floor."""
    slide = '<joint type="slide" axis="{}" {}/>'
    root = slide.format("1 0 0", 'ref="1.2" range="-1 1"') + slide.format("0 1 0", 'stiffness="9"')
    root += '<joint type="hinge" axis="0 0 1"/>'
    robot = dataclasses.replace(_table(tmp_path, root=root), root="planar")
    robot.mjcf.write_text(robot.mjcf.read_text().replace('pos="0 0 0.6"', 'pos="2 1 0.6"'))
    model = scene.build(robot)
    assert not model.jnt_limited[:3].any() and not model.jnt_stiffness[:3].any()
    assert _contypes(model)["plate"] == stock.WALLS_ONLY
    assert posture.lowest(model, model.key_qpos[0]) >= posture.CLEARANCE * robot.cell - 1e-9
    engine = engines.make(robot)
    walls_xy = jnp.tile(jnp.array(scene.PARKED_XY), (robot.num_walls, 1)).at[0].set(3.5)
    walls_xy = walls_xy.at[0, 1].set(0.0)  # its face is at x = 2
    state = engine_lib.reset(jnp.zeros(model.nq), jnp.zeros(model.nv).at[0].set(3.0))
    for _ in range(20):
        state = engine.step(state, jnp.zeros(model.nu), walls_xy)
    assert 1.0 < float(state.qpos[0]) < 1.7


def test_controls_are_shares_of_each_actuators_range(tmp_path):
    """-1 and 1 are the ends, 0 is the middle of a motor's range and a servo's start posture."""
    kinds = (
        '<motor joint="leg_0" ctrlrange="0 4"/>',
        SERVO.format(i=1, options='ctrlrange="0.3 1.5"'),
        SERVO.format(i=2, options='inheritrange="1"'),
        '<motor joint="leg_3" gear="2" ctrllimited="false" forcerange="-6 6"/>',
    )
    start = (0.0, 0.0, 0.65, 1.0, 0.0, 0.0, 0.0, 0.5, 0.6, 0.7, 0.8)
    robot = _table(tmp_path, actuators="".join(kinds), start=start)
    found = controls.of(scene.build(robot), robot)
    low, high = np.deg2rad([20.0, 60.0])
    np.testing.assert_allclose(found.low, [0.0, 0.3, low, -6.0], rtol=1e-6)
    np.testing.assert_allclose(found.rest, [2.0, 0.6, 0.7, 0.0], rtol=1e-6)
    np.testing.assert_allclose(found.high, [4.0, 1.5, high, 6.0], rtol=1e-6)
    for ctrl, expected in ((-2.0, found.low), (0.0, found.rest), (1.0, found.high)):
        np.testing.assert_array_equal(found.of(np.full(4, ctrl, np.float32)), expected)
    half = found.of(jnp.full(4, 0.5))
    np.testing.assert_allclose(half, (found.rest + found.high) / 2, rtol=1e-6)

    narrow = dataclasses.replace(robot, servo_range=0.1)
    found = controls.of(scene.build(narrow), narrow)
    np.testing.assert_allclose(found.low, [0.0, 0.5, 0.6, -6.0], rtol=1e-6)
    np.testing.assert_allclose(found.high, [4.0, 0.7, 0.8, 6.0], rtol=1e-6)

    # While it gets up, three times as far, and no farther.
    wide = dataclasses.replace(narrow, recovery_range=0.3)
    found = controls.of(scene.build(wide), wide)
    np.testing.assert_allclose(found.of(np.full(4, 1.0, np.float32)), [4.0, 0.7, 0.8, 6.0], 1e-6)
    np.testing.assert_allclose(found.of(np.full(4, 9.0, np.float32))[1:3], [0.9, 1.0], 1e-6)
    with pytest.raises(base.UserError, match="recovery_range = 0.05 must be at least servo_range"):
        dataclasses.replace(narrow, recovery_range=0.05)
    with pytest.raises(base.UserError, match="recovery_range widens servo_range"):
        dataclasses.replace(robot, recovery_range=0.3)


def test_filters_are_left_out(tmp_path):
    general = '<general joint="leg_0" ctrlrange="-1 1" dyntype="filter" dynprm="0.1"/>'
    model = scene.build(_table(tmp_path, actuators=general))
    assert model.na == 0 and model.nu == 1


def test_a_small_robot_has_cells_that_fit_it(tmp_path):
    """Half as large a cell: the same robot, seen and stopped in units, is twice as large."""
    slide = '<joint type="slide" axis="{}" damping="5"/>'
    root = slide.format("1 0 0") + slide.format("0 1 0") + '<joint type="hinge" axis="0 0 1"/>'
    robot = dataclasses.replace(_table(tmp_path, root=root), root="planar")
    small = dataclasses.replace(robot, cell=1.5, reach=0.7)
    assert small.num_walls == 3 and small.units_per_metre == 2.0
    model = scene.build(small)
    assert model.geom(scene.wall_name(0)).size[0] == 0.75
    engine, walls_xy = engines.make(small), jnp.tile(jnp.array(scene.PARKED_XY), (3, 1))
    speed = jnp.zeros(model.nv).at[0].set(1.0)
    moved = engine.step(engine_lib.reset(jnp.zeros(model.nq), speed), jnp.zeros(4), walls_xy)
    plain = engines.make(robot).step(
        engine_lib.reset(jnp.zeros(model.nq), speed), jnp.zeros(4), walls_xy
    )
    assert float(moved.qpos[0]) == pytest.approx(2.0 * float(plain.qpos[0]), rel=1e-4)
    walls_xy = walls_xy.at[0].set(jnp.array([3.5, 0.0]))  # its face is at x = 2 units, 1 m
    state = engine_lib.reset(jnp.zeros(model.nq), 3.0 * speed)
    for _ in range(20):
        state = engine.step(state, jnp.zeros(4), walls_xy)
    # A leg that swings forward is up to 0.7 m ahead of the torso, the plate 0.4 m.
    assert 2.0 * 0.25 < float(state.qpos[0]) < 2.0 * 0.65
    one, two = (
        jax.jit(kinematics.capsules(model, scale))(state.qpos.at[:2].set(0.0))
        for scale in (1.0, 2.0)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(2.0 * a, b, atol=1e-6), one, two)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('ctrlrange="-3 3"', 'ctrllimited="false"', "actuator 0 has no range: give it a ctrlrange"),
        ('range="20 60"', 'range="20 inf"', "jnt range must be finite"),
        ('name="flag"', 'name="scene: floor"', "scene: floor"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(tmp_path, old, new, message):
    robot = _table(tmp_path)
    text = robot.mjcf.read_text()
    assert old in text
    robot.mjcf.write_text(text.replace(old, new))
    with pytest.raises(base.UserError, match=message) as error:
        scene.build(robot)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["wall_0", "floor", "wall_x"])
def test_names_are_the_files_own(tmp_path, name):
    robot = _table(tmp_path)
    robot.mjcf.write_text(robot.mjcf.read_text().replace('"leg_0"', f'"{name}"'))
    model = scene.build(robot)
    assert model.body(name).mocapid[0] < 0 and model.geom(name).contype[0] == stock.BOTH


def test_a_total_mass_is_the_files_own_and_walls_have_no_part_in_it(tmp_path):
    robot = _table(tmp_path)
    text = robot.mjcf.read_text().replace("<option", '<compiler settotalmass="70"/><option', 1)
    robot.mjcf.write_text(text)
    # As its file has it, in a world with a fence and a ball.
    whole = mujoco.MjModel.from_xml_path(str(robot.mjcf))

    model = scene.build(robot)
    for name in ("plate", "leg_0"):
        ours, theirs = (one.body(name) for one in (model, whole))
        np.testing.assert_allclose(ours.mass, theirs.mass, rtol=1e-9)
        np.testing.assert_allclose(ours.inertia, theirs.inertia, rtol=1e-9)
        np.testing.assert_allclose(ours.invweight0, theirs.invweight0, rtol=1e-6)
    assert model.body("plate").subtreemass[0] < 60.0  # The ball has the rest.
