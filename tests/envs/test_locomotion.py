"""The low level's task: its reward, its symmetry, its subgoals and its guard."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, robots
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import experience, locomotion, low_obs, low_reward, rooms, wrappers
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import paths
from eihrl_jax.ops import rotations
from eihrl_jax.physics import engines

ANT, POINT = (robots.load(name) for name in ("ant", "point"))


@pytest.fixture(scope="module")
def ant_engine():
    return engines.make(ANT, "mujoco")


DRIFT = {"lateral_weight": 0.5, "beyond_cell": 0.0}


@functools.cache
def _compiled(engine, ends_at_fall=True, **options):
    """Returns reset and step of episodes of 60 steps that follow each other, compiled once."""
    env = wrappers.AutoReset(
        locomotion.Locomotion(
            engine,
            rooms.open_floor(),
            reward_options=low_config.LowReward(**options),
            episode_steps=60,
            ends_at_fall=ends_at_fall,
        )
    )
    return jax.jit(env.reset), jax.jit(env.step)


@pytest.fixture(scope="module")
def point_engine():
    return engines.make(POINT, "mujoco")


@pytest.mark.parametrize("num_rooms", [0, 4])
def test_robots_start_as_far_off_the_middle_as_they_are_told(point_engine, num_rooms):
    config = dataclasses.replace(
        presets.LOW["point"], num_rooms=num_rooms, start_jitter=0.9, anchored=True
    )
    env = locomotion.Locomotion.of_config(point_engine, config)
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 64))

    # The first subgoal counts from the middle of the cell.
    offset = states.obs.displacement_xy
    assert 0.75 < jnp.abs(offset).max() <= 0.9 + 1e-4


def _obs(displacement_xy, time_left=1.0, direction=0):
    """An observation of which the reward looks at all but the body."""
    return low_obs.LowObs(
        proprioception=jnp.zeros(0),
        displacement_xy=jnp.float32(displacement_xy),
        time_left=jnp.float32(time_left),
        direction=jnp.int32(direction),
    )


@pytest.mark.parametrize("direction", range(4))
def test_plain_reward_is_equation_1(direction):
    rng = np.random.default_rng(direction)
    for _ in range(5):
        step, before = rng.normal(size=2), rng.normal(size=2)
        goal = np.array(base.DIRECTIONS_XY[direction])
        cosine = goal @ step / np.linalg.norm(step)
        expected = 3.0 * cosine * np.linalg.norm(step)
        obs = _obs(before, time_left=0.5, direction=direction)
        paid = low_reward.step_reward(
            obs, jnp.float32(step), jnp.array(False), low_config.LowReward(), 25
        )
        np.testing.assert_allclose(paid, expected, atol=1e-5)


def test_reward_is_zero_and_smooth_at_rest():
    slope = jax.grad(low_reward.step_reward, argnums=1)(
        _obs([0.0, 0.0]), jnp.zeros(2), jnp.array(False), low_config.LowReward(), 25
    )
    np.testing.assert_allclose(slope, [3.0, 0.0])


def _pay(before, step, fell=False, time_left=1.0, **options):
    """Reward of a step towards y+, with four steps per subgoal."""
    options = low_config.LowReward(scale=1.0, **options)
    obs = _obs(before, time_left, direction=2)
    return float(low_reward.step_reward(obs, jnp.array(step), jnp.array(fell), options, 4))


def test_going_too_far_before_an_anchored_subgoal_earns_nothing():
    """What the way back to the anchor pays has been charged when the subgoal was given."""
    options = low_config.LowReward(scale=1.0, lateral_weight=1.0, beyond_cell=-1.0)
    ended = low_reward.StepOutcome(
        terminated=jnp.array(False), is_switch=jnp.array(True), upright=jnp.float32(1.0)
    )

    def total(step, off):
        """Pay for a step towards x+, and, as far as it was off, for going back towards y+."""
        given = _obs([off, 0.0], direction=2)
        first = low_reward.reward(_obs([2.0, 0.0]), given, jnp.array(step), ended, options, 4)
        later = ended.replace(is_switch=jnp.array(False))
        back = low_reward.reward(given, given, jnp.array([-off, 0.0]), later, options, 4)
        return float(first + back)

    assert total([1.0, 0.0], 0.0) == pytest.approx(1.0)
    assert total([1.5, 0.0], 0.5) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("before", "step", "time_left", "expected"),
    [
        (0.0, 0.75, 1.0, 0.75),  # in step with the point that moves 3 units in 4 steps
        (0.0, 2.0, 1.0, 0.75 - 1.25),  # 1.25 ahead of it
        (2.0, 0.0, 0.5, 1.0),  # it catches up with a robot that waits half a unit ahead
        (0.0, 0.5, 0.25, 0.5),  # far behind, all progress counts
    ],
)
def test_paced_reward_pays_no_hurry(before, step, time_left, expected):
    options = {"beyond_cell": -1.0, "is_paced": True, "time_left": time_left}
    assert _pay([0.0, before], [0.0, step], **options) == pytest.approx(expected)


def test_drift_costs_and_coming_back_pays_it_back():
    assert _pay([0.0, 0.0], [1.0, 0.0], lateral_weight=0.5) == pytest.approx(-0.5)
    assert _pay([1.0, 0.0], [-1.0, 0.0], lateral_weight=0.5) == pytest.approx(0.5)


@pytest.mark.parametrize(("beyond_cell", "expected"), [(1.0, 2.0), (0.0, 1.0), (-1.0, 0.0)])
def test_progress_beyond_a_cell(beyond_cell, expected):
    """A step of two units, the second of which is beyond the cell."""
    assert _pay([0.0, 2.0], [0.0, 2.0], beyond_cell=beyond_cell) == pytest.approx(expected)
    back = _pay([0.0, 4.0], [0.0, -2.0], beyond_cell=beyond_cell)
    assert back == pytest.approx(-expected)


def test_a_fall_costs_once():
    assert _pay([0.0, 0.0], [0.0, 0.0], fell=True, fall_cost=5.0) == -5.0
    assert _pay([0.0, 0.0], [0.0, 0.0], fell=False, fall_cost=5.0) == 0.0


def _drive(engine, direction_of, num_steps, **options):
    """Pushes the point along `direction_of(state)` and collects every state."""
    reset, step = _compiled(engine, **options)
    states = [reset(jax.random.key(0))]
    for _ in range(num_steps):
        direction = int(direction_of(states[-1]))
        states.append(step(states[-1], jnp.array(base.DIRECTIONS_XY[direction])))
    return states


def test_point_collects_its_displacement_and_switches_every_k_steps(point_engine):
    states = _drive(point_engine, lambda state: state.obs.direction, 50)
    switched = [i for i, state in enumerate(states) if state.metrics["switched"] > 0]
    assert switched == [25, 50]
    total = sum(float(state.reward) for state in states[1:26])
    along = float(states[25].metrics["along"])
    assert total == pytest.approx(3.0 * along, rel=1e-4) and along > 3.0
    np.testing.assert_allclose(states[25].obs.displacement_xy, 0.0, atol=1e-6)
    assert float(states[25].obs.time_left) == 1.0
    assert float(states[24].obs.time_left) == pytest.approx(1 / 25)


def test_stored_step_relabelled_pays_as_if_the_other_direction_had_been_asked(point_engine):
    options = low_config.LowReward(**DRIFT)

    @jax.jit
    def see(row):
        return experience.transition(row, POINT, low_config.LowInput(), options, 0.9)

    states = _drive(point_engine, lambda state: 2, 25, **DRIFT)
    for before, after in itertools.pairwise(states):
        ctrl = jnp.array(base.DIRECTIONS_XY[2])
        stored = experience.of_step(before, ctrl, after)
        same = experience.relabel(stored, before.obs.direction)
        seen = see(same)
        np.testing.assert_allclose(seen.reward, after.reward, atol=1e-4)
        other = experience.relabel(stored, jnp.int32(2))
        is_switch = bool(stored.outcome.is_switch)
        expected = after.final_obs.direction if is_switch else 2
        assert int(other.obs.direction) == 2 and int(other.next_obs.direction) == expected
        assert float(seen.discount) == pytest.approx(0.9)
    assert is_switch


def test_a_step_restarted_is_the_first_of_its_subgoal(point_engine):
    """It is what a fresh subgoal would have stored: nothing moved yet, all time left."""
    states = _drive(point_engine, lambda state: 2, 25)
    for before, after in itertools.pairwise(states[12:]):
        stored = experience.of_step(before, jnp.zeros(2), after)
        anew = experience.restart(stored, jnp.int32(1), POINT)
        assert not anew.outcome.is_switch
        for obs, displacement, steps_left in (
            (anew.obs, np.zeros(2), 25),
            (anew.next_obs, stored.step_xy, 24),
        ):
            assert int(obs.direction) == 1
            assert float(obs.time_left) == pytest.approx(steps_left / 25)
            np.testing.assert_array_equal(obs.displacement_xy, displacement)
        np.testing.assert_array_equal(anew.next_obs.proprioception, stored.next_obs.proprioception)


def test_a_turned_over_ant_has_fallen(ant_engine):
    stand = jnp.float32(ant_engine.model.key_qpos[0])
    assert not body_lib.is_fallen(stand, ANT)
    assert body_lib.is_fallen(stand.at[2].set(0.1), ANT)
    assert body_lib.is_fallen(stand.at[2].set(1.2), ANT)
    assert body_lib.is_fallen(stand.at[3:7].set(jnp.array([0.0, 1.0, 0.0, 0.0])), ANT)


def test_where_falls_do_not_end_episodes_they_are_told_once(ant_engine):
    reset, step = _compiled(ant_engine, ends_at_fall=False)
    state, zero = reset(jax.random.key(0)), jnp.zeros(8)
    lifted = state.inner.physics.replace(qpos=state.inner.physics.qpos.at[2].set(1.4))
    above = step(state.replace(inner=state.inner.replace(physics=lifted)), zero)
    assert not above.terminated and float(above.metrics["fell"]) == 0.0  # lay there before
    low = lifted.replace(qpos=lifted.qpos.at[2].set(0.99), qvel=lifted.qvel.at[2].set(5.0))
    told = []
    state = state.replace(inner=state.inner.replace(physics=low))
    for _ in range(3):
        state = step(state, zero)
        told.append(float(state.metrics["fell"]))
    assert told == [1.0, 0.0, 0.0] and not state.terminated


def test_fall_terminates_and_starts_anew(ant_engine):
    reset, step = _compiled(ant_engine)
    state = reset(jax.random.key(0))
    physics = state.inner.physics
    upside_down = physics.qpos.at[3:7].set(jnp.array([0.0, 1.0, 0.0, 0.0]))
    fallen = state.inner.replace(physics=physics.replace(qpos=upside_down))
    after = step(state.replace(inner=fallen), jnp.zeros(8))
    assert bool(after.terminated) and float(after.metrics["fell"]) == 1.0
    assert int(after.inner.step) == 0 and float(after.inner.physics.qpos[2]) == 0.75
    assert abs(float(after.final_obs.proprioception[2])) > 0.9


def test_broken_simulation_ends_the_episode_and_poisons_nothing(ant_engine):
    reset, step = _compiled(ant_engine)
    state = reset(jax.random.key(0))
    physics = state.inner.physics
    broken = state.inner.replace(physics=physics.replace(qvel=physics.qvel.at[3].set(1e30)))
    after = step(state.replace(inner=broken), jnp.zeros(8))
    assert bool(after.terminated) and float(after.metrics["broke_down"]) == 1.0
    assert float(after.reward) == 0.0


def test_controls_that_are_no_numbers_count_as_a_breakdown(point_engine):
    reset, step = _compiled(point_engine)
    after = step(reset(jax.random.key(0)), jnp.full(2, jnp.nan))
    assert bool(after.terminated) and float(after.metrics["broke_down"]) == 1.0


def test_time_limit_truncates_and_episodes_differ(point_engine):
    states = _drive(point_engine, lambda state: state.obs.direction, 60)
    assert bool(states[-1].truncated) and not bool(states[-1].terminated)
    first, second = states[0].inner, states[-1].inner
    assert int(second.step) == 0
    assert not np.allclose(first.physics.qpos, second.physics.qpos)


def test_rooms_are_half_empty_and_start_where_it_is_free():
    drawn = rooms.random_rooms(8, seed=3)
    inner = np.asarray(drawn.mazes.wall)[:, 1:-1, 1:-1]
    assert not inner[::2].any() and inner[1::2].any((1, 2)).all()
    assert not (np.asarray(drawn.mazes.start) & np.asarray(drawn.mazes.wall)).any()


def test_corridors_are_one_cell_wide_and_lead_everywhere():
    drawn = rooms.random_rooms(8, seed=3, corridor_share=0.25)
    assert np.asarray(drawn.is_corridor).tolist() == [False] * 6 + [True] * 2
    for wall in np.asarray(drawn.mazes.wall)[-2:]:
        free = ~wall
        square = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]
        assert not square.any() and free[1::2, 1::2].all()
        assert paths.largest_part(free).sum() == free.sum()
    plain = rooms.random_rooms(8, seed=3).mazes.wall
    np.testing.assert_array_equal(drawn.mazes.wall[:6], plain[:6])


def test_in_corridors_directions_are_free_and_subgoals_anchored(point_engine):
    """A point that is carried from subgoal to subgoal is always sent where there is no wall."""
    corridors = rooms.random_rooms(4, seed=1, corridor_share=1.0)
    reward = low_config.LowReward()
    env = locomotion.Locomotion(point_engine, corridors, reward_options=reward)

    def walk(state, _):
        """Puts the point where its subgoal leads, a little off, and takes the last step there."""
        inner, k = state.inner, POINT.steps_per_subgoal
        centre = maze_lib.cell_xy(maze_lib.cell_ij(inner.physics.qpos))
        toward = jnp.array(base.DIRECTIONS_XY, jnp.float32)[inner.direction]
        ahead = centre + base.CELL * toward
        is_wall = maze_lib.is_wall(env.room(inner.room), ahead)
        anchor_off = jnp.abs(inner.subgoal_xy - centre).max()
        physics = inner.physics.replace(qpos=ahead + 0.4, qvel=jnp.zeros(2))
        moved = state.replace(inner=inner.replace(physics=physics, step=jnp.int32(k - 1)))
        return env.step(moved, jnp.zeros(2)), (is_wall, anchor_off, inner.direction)

    walks = jax.jit(lambda state: jax.lax.scan(walk, state, length=200)[1])
    is_wall, anchor_off, direction = walks(env.reset(jax.random.key(0)))
    assert not is_wall.any() and float(anchor_off.max()) < 1e-3
    assert len(set(direction.tolist())) == 4


def test_turning_the_world_turns_the_physics(ant_engine):
    """An ant turned by a quarter ends up where the other one does, turned: relabelling is exact."""
    physics = _compiled(ant_engine)[0](jax.random.key(5)).inner.physics
    inverse = jnp.int32(3)
    qvel = physics.qvel.at[:2].set(rotations.to_world_frame(physics.qvel[:2], jnp.int32(2)))
    quat = rotations.quaternion_to_direction_frame(physics.qpos[3:7], inverse)
    turned = dataclasses.replace(physics, qpos=physics.qpos.at[3:7].set(quat), qvel=qvel)
    walls_xy = jnp.full((3, 2), -1000.0)
    ctrl = jnp.linspace(-1.0, 1.0, 8)
    one, other = physics, turned
    for _ in range(5):
        one = ant_engine.step(one, ctrl, walls_xy)
        other = ant_engine.step(other, ctrl, walls_xy)
    moved = rotations.to_world_frame(one.qpos[:2] - physics.qpos[:2], jnp.int32(2))
    np.testing.assert_allclose(other.qpos[:2] - turned.qpos[:2], moved, atol=2e-3)
    np.testing.assert_allclose(other.qpos[7:], one.qpos[7:], atol=2e-3)
