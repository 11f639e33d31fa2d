"""Both engines agree, and are pure functions of one robot under every transformation of JAX."""

import concurrent.futures

import chex
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import batch

from eihrl_jax import base, robots
from eihrl_jax.physics import engines, host_call

CORNER = jnp.array([[2.3, -0.7], [-0.7, 2.3], [2.3, 2.3]])
"""Walls whose faces are 0.8 units right of and above the origin, within an ant's reach."""


MJX_ROWS = 8
"""Of every call of MJX, which is then compiled once."""


def free_run(step, state, ctrls, walls_xy):
    """States after each control step of a batch."""
    states = []
    for ctrl in ctrls:
        state = step(state, ctrl, walls_xy)
        states.append(state)
    return states


def take(tree, index):
    """Part of a batch."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[index]), tree)


def apart(run, truth):
    """Greatest deviation of a position: array [steps, robots]."""
    return np.array(
        [
            np.abs(np.asarray(a.qpos) - np.asarray(b.qpos)).max(1)
            for a, b in zip(run, truth, strict=True)
        ]
    )


def test_mjx_agrees_with_the_c_engine_over_fifty_steps(
    ant, mjx_step, standing, parked, random_ctrls
):
    """Half of the ants on open floor, half thrown into a corner.

    One control step from the same state: within 1e-3 units or radians, always (5e-7 was the
    greatest of 1,600; float32 rounds at 1e-7). Free runs: contacts make legged robots chaotic, C
    runs from starts that differ by a float32 rounding are up to 0.2 apart after 50 steps. What can
    be asked for is that most ants stay together: the median within 1e-3 (measured 4e-6), 80 % of
    all steps within 0.02 (90 % measured within 7e-5).
    """
    num, num_steps = MJX_ROWS // 2, 50
    walls_xy = jnp.concatenate([parked(ant, num // 2), jnp.tile(CORNER, (num // 2, 1, 1))])
    start = standing(ant, num)
    start = start.replace(qvel=start.qvel.at[:, :2].set(1.0))
    ctrls = random_ctrls(ant, num_steps, num)
    truth = free_run(jax.jit(jax.vmap(ant.step)), start, ctrls, walls_xy)

    # Half of the rows make one step from each state of the C engine, half run freely.
    free, one_step, free_states = start, [], []
    for state, ctrl in zip([start, *truth[:-1]], ctrls, strict=True):
        inputs = (state, ctrl, walls_xy), (free, ctrl, walls_xy)
        both = mjx_step(*jax.tree.map(lambda *x: jnp.concatenate(x), *inputs))
        free = take(both, np.s_[num:])
        one_step.append(take(both, np.s_[:num]))
        free_states.append(free)

    assert apart(one_step, truth).max() < 1e-3
    deviation = apart(free_states, truth)
    assert np.median(deviation) < 1e-3
    assert np.quantile(deviation, 0.8) < 0.02

    unwalled = free_run(jax.jit(jax.vmap(ant.step)), start, ctrls, parked(ant, num))
    assert (apart(unwalled, truth).max(0)[num // 2 :] > 0.1).all(), "the walls were not touched"


def test_mjx_leaves_out_no_contact_of_ants_that_tumble_between_walls(ant, standing, random_ctrls):
    """Only where most of an ant is in the floor some are, and counted."""
    num, num_steps = 16, 25
    passage = jnp.array([[0.0, 2.3], [0.0, -2.3], [3.0, -2.3]])
    walls_xy = jnp.concatenate([jnp.tile(x, (num // 2, 1, 1)) for x in (CORNER, passage)])
    start = standing(ant, num, speed=2.0)
    turned = jax.random.normal(jax.random.key(0), (num, 4))
    start = start.replace(qpos=start.qpos.at[:, 3:7].set(turned).at[:, 2].set(1.0))
    states = free_run(
        jax.jit(jax.vmap(ant.step)), start, random_ctrls(ant, num_steps, num), walls_xy
    )

    num_dropped = jax.jit(jax.vmap(engines.make(ant.robot, "mjx").num_dropped))
    assert sum(int(num_dropped(state, walls_xy).sum()) for state in states) == 0
    sunk = start.replace(qpos=standing(ant, num).qpos.at[:, 2].set(0.0))
    assert (num_dropped(sunk, walls_xy) > 0).all()


def test_the_c_engine_drifts_from_itself(ant, standing, parked, random_ctrls):
    """Why free runs of two engines can't be compared more closely than above."""
    step = jax.jit(jax.vmap(ant.step))
    start, walls_xy = standing(ant, 32), parked(ant, 32)
    nudged = start.replace(qpos=start.qpos * (1 + 2.0**-23))
    ctrls = random_ctrls(ant, 50, 32)
    deviation = apart(
        free_run(step, nudged, ctrls, walls_xy), free_run(step, start, ctrls, walls_xy)
    )
    assert deviation[0].max() < 1e-5 and deviation[-1].max() > 1e-3


def test_jit_eager_loop_and_scan_agree(ant, standing, parked, random_ctrls):
    start, ctrls, walls_xy = standing(ant, 3), random_ctrls(ant, 5, 3), parked(ant, 3)
    batched = jax.jit(jax.vmap(ant.step))
    expected = free_run(batched, start, ctrls, walls_xy)
    alone = [
        free_run(ant.step, take(start, n), take(ctrls, np.s_[:, n]), take(walls_xy, n))[-1]
        for n in range(3)
    ]
    chex.assert_trees_all_equal(jax.tree.map(lambda *x: jnp.stack(x), *alone), expected[-1])
    scanned = jax.lax.scan(lambda s, u: (batched(s, u, walls_xy), None), start, ctrls)[0]
    chex.assert_trees_all_equal(scanned, expected[-1])
    inputs = take((start, ctrls[0], walls_xy), np.s_[:, None])
    nested = jax.vmap(jax.vmap(ant.step))(*inputs)
    chex.assert_trees_all_equal(take(nested, np.s_[:, 0]), expected[0])


def test_mjx_on_a_cpu_shares_no_cholesky_among_threads(mjx_step, ant, standing, parked):
    """LAPACK's waits forever for 256 rows, which are the same program; see `_safe_cholesky`."""
    ctrls = jnp.zeros((MJX_ROWS, ant.model.nu))
    lowered = mjx_step.lower(standing(ant, MJX_ROWS), ctrls, parked(ant, MJX_ROWS)).as_text()
    assert "while" in lowered
    assert "potrf" not in lowered


@pytest.mark.slow
def test_mjx_under_scan_and_batch_sizes(mjx_step, ant, standing, parked, random_ctrls):
    """MJX gives a robot the same steps alone as in a batch, up to float32 rounding."""
    start, ctrls, walls_xy = standing(ant, 4), random_ctrls(ant, 3, 4), parked(ant, 4)
    expected = free_run(mjx_step, start, ctrls, walls_xy)[-1]
    alone = free_run(mjx_step, take(start, np.s_[:1]), ctrls[:, :1], walls_xy[:1])[-1]
    np.testing.assert_allclose(alone.qpos[0], expected.qpos[0], atol=1e-4)
    scanned = jax.jit(
        lambda s: jax.lax.scan(lambda s, u: (mjx_step(s, u, walls_xy), None), s, ctrls)[0]
    )(start)
    np.testing.assert_allclose(scanned.qpos, expected.qpos, atol=1e-4)


def test_results_do_not_depend_on_batch_or_threads(ant, standing, parked, random_ctrls):
    num = 24
    start, ctrl, walls_xy = standing(ant, num), random_ctrls(ant, num), parked(ant, num)
    whole = jax.vmap(ant.step)(start, ctrl, walls_xy)
    halves = [
        jax.vmap(ant.step)(*take((start, ctrl, walls_xy), part))
        for part in (np.s_[:12], np.s_[12:])
    ]
    chex.assert_trees_all_equal(jax.tree.map(lambda *x: jnp.concatenate(x), *halves), whole)
    for num_threads in (1, 3):
        rows = batch.Batch(ant.model, num, nthread=num_threads)
        rows.bind("qpos")[:], rows.bind("qvel")[:] = start.qpos, start.qvel
        rows.bind("ctrl")[:] = ctrl
        rows.bind("mocap_pos")[..., :2] = walls_xy
        rows.step(nstep=ant.robot.num_substeps)
        np.testing.assert_array_equal(rows.bind("qpos").astype(np.float32), whole.qpos)


def test_the_state_alone_decides(ant, standing, parked, random_ctrls):
    """No row keeps anything from the call before: the same state gives the same step again."""
    start, ctrl, walls_xy = standing(ant, 4), random_ctrls(ant, 4), parked(ant, 4)
    first = jax.vmap(ant.step)(start, ctrl, walls_xy)
    jax.vmap(ant.step)(standing(ant, 4, seed=5, speed=9.0), -ctrl, jnp.tile(CORNER, (4, 1, 1)))
    chex.assert_trees_all_equal(jax.vmap(ant.step)(start, ctrl, walls_xy), first)


def test_threads_may_share_an_engine(ant, standing, parked, random_ctrls):
    start, ctrls, walls_xy = standing(ant, 8), random_ctrls(ant, 6, 8), parked(ant, 8)
    step = jax.jit(jax.vmap(ant.step))
    expected = [step(start, ctrl, walls_xy) for ctrl in ctrls]
    with concurrent.futures.ThreadPoolExecutor(6) as pool:
        at_once = list(pool.map(lambda ctrl: step(start, ctrl, walls_xy), ctrls))
    chex.assert_trees_all_equal(at_once, expected)


def test_controls_are_clipped(ant, standing, parked):
    start, walls_xy = standing(ant, 2), parked(ant, 2)
    ones = jnp.ones((2, ant.model.nu))
    chex.assert_trees_all_equal(
        jax.vmap(ant.step)(start, 5 * ones, walls_xy), jax.vmap(ant.step)(start, ones, walls_xy)
    )


def test_what_breaks_down_leaves_no_log_where_the_user_is(
    ant, standing, parked, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    start = standing(ant, 3)
    broken = start.replace(qvel=start.qvel.at[1, 6].set(1e30))
    after = jax.vmap(ant.step)(broken, jnp.zeros((3, 8)), parked(ant, 3))
    assert not jnp.isfinite(after.qpos[1]).all()
    assert not any(tmp_path.iterdir()) and capfd.readouterr() == ("", "")


def test_nan_positions_stay_nan_and_alone(ant, standing, parked, random_ctrls):
    """A broken robot must be seen by the environment's guard, not put back to the origin."""
    start, ctrl, walls_xy = standing(ant, 3), random_ctrls(ant, 3), parked(ant, 3)
    broken = start.replace(qpos=start.qpos.at[1, 7].set(jnp.nan))
    after = jax.vmap(ant.step)(broken, ctrl, walls_xy)
    assert jnp.isnan(after.qpos[1]).any()
    healthy = jax.vmap(ant.step)(start, ctrl, walls_xy)
    np.testing.assert_array_equal(after.qpos[::2], healthy.qpos[::2])


def test_robots_that_are_not_running_rest(ant, standing, parked, random_ctrls):
    start, ctrl, walls_xy = standing(ant, 3), random_ctrls(ant, 3), parked(ant, 3)
    is_running = jnp.array([True, False, True])
    for resting_ctrl in (ctrl[1], jnp.nan):
        ctrls = ctrl.at[1].set(resting_ctrl)
        after = jax.vmap(ant.step)(start, ctrls, walls_xy, is_running)
        chex.assert_trees_all_equal(take(after, 1), take(start, 1))
        healthy = jax.vmap(ant.step)(start, ctrl, walls_xy)
        np.testing.assert_array_equal(after.qpos[::2], healthy.qpos[::2])


def test_nan_controls_of_a_running_robot_break_it_down(ant, standing, parked, random_ctrls):
    start, ctrl, walls_xy = standing(ant, 3), random_ctrls(ant, 3), parked(ant, 3)
    after = jax.vmap(ant.step)(start, ctrl.at[1, 0].set(jnp.nan), walls_xy)
    assert jnp.isnan(after.qpos[1]).all()
    healthy = jax.vmap(ant.step)(start, ctrl, walls_xy)
    np.testing.assert_array_equal(after.qpos[::2], healthy.qpos[::2])


def test_the_c_engine_is_mujoco(ant, standing, parked, random_ctrls):
    """One control step equals `mj_step` called by hand."""
    start, ctrl = standing(ant, 1), random_ctrls(ant, 1)
    after = jax.vmap(ant.step)(start, ctrl, parked(ant, 1))
    data = mujoco.MjData(ant.model)
    data.qpos, data.qvel, data.ctrl = start.qpos[0], start.qvel[0], ctrl[0]
    for _ in range(ant.robot.num_substeps):
        mujoco.mj_step(ant.model, data)
    np.testing.assert_array_equal(after.qpos[0], data.qpos.astype(np.float32))


def test_programs_that_step_the_c_engine_can_be_kept(ant, standing, parked):
    """Nothing in them belongs to this process: any engine of the same model makes the same one."""
    start, ctrl, walls_xy = standing(ant, 2), jnp.zeros((2, ant.model.nu)), parked(ant, 2)
    another, narrower = (engines.make(ant.robot, cell=cell) for cell in (None, 2.0))
    texts = [
        jax.jit(jax.vmap(engine.step)).lower(start, ctrl, walls_xy).as_text()
        for engine in (ant, another, narrower)
    ]
    assert texts[0] == texts[1] != texts[2]
    assert "callback" not in texts[0], "JAX's persistent cache refuses programs with host callbacks"


def test_a_host_function_that_fails_says_why():
    def fail(arguments, results):
        raise ValueError(f"can't do {arguments[0].tolist()}")

    host_call.register("eihrl_jax.test.fail", fail)
    shapes = [jax.ShapeDtypeStruct((2,), jnp.float32)]
    step = jax.jit(lambda x: host_call.call("eihrl_jax.test.fail", fail, shapes, [x])[0])
    with pytest.raises(jax.errors.JaxRuntimeError, match=r"ValueError: can't do \[1.0, 2.0\]"):
        step(jnp.array([1.0, 2.0])).block_until_ready()


def test_unknown_engine():
    with pytest.raises(base.UserError, match="engine 'brax' is unknown; choose one of mujoco, mjx"):
        engines.make(robots.load("point"), "brax")
