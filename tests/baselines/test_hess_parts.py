"""What HESS is made of: its two levels, memory, subgoal space and choice of subgoals."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.agents import replay
from eihrl_jax.baselines.hess import episodes, exploration, hess, learning, levels, representation
from eihrl_jax.config import hess as config
from eihrl_jax.envs import goal_maze
from tests.envs import sled

SAC = config.Sac(hidden=(32, 32), reach=2.0, learning_rate=3e-3, temperature=0.01, target_rate=0.05)
DDPG = config.Ddpg(
    hidden=(32, 32),
    critic_hidden=(32, 32),
    learning_rate=2e-3,
    gamma=0.9,
    target_rate=0.2,
    batch_size=64,
)


def transitions(key, reward, reach):
    """Ends after random observations of two numbers and actions of one, which pay `reward`."""
    obs_key, action_key, next_key = jax.random.split(key, 3)
    obs = jax.random.uniform(obs_key, (64, 2), minval=-1.0, maxval=1.0)
    action = jax.random.uniform(action_key, (64, 1), minval=-reach, maxval=reach)
    return base.Transition(
        obs=obs,
        action=action,
        reward=jnp.full(64, reward, jnp.float32),
        discount=jnp.zeros(64),
        next_obs=jax.random.uniform(next_key, (64, 2), minval=-1.0, maxval=1.0),
    )


def test_targets_are_clipped_where_a_floor_is_given():
    agent = levels.Sac(2, 1, dataclasses.replace(SAC, temperature=0.0), value_floor=-5.0)

    def body(state, key):
        batch_key, update_key = jax.random.split(key)
        batch = transitions(batch_key, -100.0, 2.0)
        return agent.update(state, batch, jnp.ones(64), update_key)

    keys = jax.random.split(jax.random.key(1), 1000)
    _, metrics = jax.jit(lambda: jax.lax.scan(body, agent.init(jax.random.key(0)), keys))()
    assert metrics["value"][-1] == pytest.approx(-5.0, abs=0.3)


def test_a_controller_of_which_no_rate_is_left_learns_nothing():
    agent = levels.Ddpg(2, 1, DDPG)
    state = agent.init(jax.random.key(0))
    batch = transitions(jax.random.key(1), -1.0, 1.0)
    after, _ = agent.update(state, batch, jnp.ones(64), jnp.float32(0.0))
    for old, new in zip(
        *map(jax.tree.leaves, (state.actor_params, after.actor_params)), strict=True
    ):
        assert jnp.array_equal(old, new)


def stored_episodes():
    """Two places for episodes of up to six steps in periods of three; one is stored, five long."""
    batch = episodes.Episodes(
        obs=jnp.arange(7.0)[None, :, None],
        place=jnp.stack([jnp.arange(7.0), -jnp.arange(7.0)], -1)[None],
        action=10.0 * jnp.arange(6.0)[None, :, None],
        subgoal=jnp.array([[[1.0, 1.0], [2.0, 2.0]]]),
        length=jnp.array([5]),
        position=jnp.int32(0),
    )
    return episodes.add(episodes.init(2, 3, 2, (1, 1)), batch)


def test_drawn_steps_are_those_that_were_stored():
    steps = episodes.sample(stored_episodes(), (300,), jax.random.key(0))
    t = np.asarray(steps.obs[:, 0])
    assert set(t.tolist()) == {0.0, 1.0, 2.0, 3.0, 4.0}
    np.testing.assert_array_equal(steps.next_obs[:, 0], t + 1)
    np.testing.assert_array_equal(steps.action[:, 0], 10 * t)
    np.testing.assert_array_equal(steps.next_place[:, 1], -t - 1)
    np.testing.assert_array_equal(steps.subgoal[:, 0], np.where(t < 3, 1.0, 2.0))


def test_ends_are_those_of_periods_that_there_were():
    obs, is_there = episodes.period_ends(stored_episodes())
    assert obs[0, :, 0].tolist() == [3.0, 6.0]
    assert is_there.tolist() == [[True, True], [False, False]]


def test_the_controller_is_paid_for_the_distance_and_its_task_ends_at_the_subgoal():
    options = config.HessConfig(controller=dataclasses.replace(DDPG, reward_scale=0.1))
    learner = learning.Learning(1, 1, 10, 100, options)
    steps = episodes.Steps(
        obs=jnp.zeros((3, 1)),
        place=jnp.array([[0.0, 0.0], [2.95, 4.0], [3.0, 4.0]]),
        subgoal=jnp.array([[3.0, 4.0]] * 3),
        action=jnp.zeros((3, 1)),
        next_obs=jnp.zeros((3, 1)),
        next_place=jnp.array([[3.0, 0.0], [3.0, 3.95], [3.0, 9.0]]),
    )
    found, weight = learner.control_transition(steps)
    np.testing.assert_allclose(found.reward, [-0.4, -0.005, -0.5], rtol=1e-4)
    np.testing.assert_allclose(found.discount, [0.9, 0.0, 0.9], rtol=1e-6)
    assert weight.tolist() == [1.0, 0.0, 0.0]


def walks(num_episodes, num_steps):
    """Episodes that go steadily along a line, seen as two numbers of which one is noise."""
    t = jnp.arange(num_steps + 1.0) / num_steps
    noise = jax.random.normal(jax.random.key(5), (num_episodes, num_steps + 1))
    seen = jnp.stack([jnp.broadcast_to(t, noise.shape), noise], -1)
    return representation.Stored(seen, jnp.full(num_episodes, num_steps, jnp.int32))


@pytest.mark.parametrize("anchors", ["best", "rest"])
def test_the_subgoal_space_is_slow_and_spreads_what_is_far_apart(anchors):
    options = config.Representation(
        hidden=(32,), learning_rate=1e-2, batch_size=64, num_updates=600, anchors=anchors
    )
    space = representation.Representation(2, 20, options)
    stored = walks(8, 40)
    state = space.init((8, 40), jax.random.key(0))
    state, loss = jax.jit(space.train)(state, stored, jnp.float32(0.1), jax.random.key(1))
    assert state.num_blocks == 1 and loss < 0.6
    here = space.place(state.params, stored.obs)
    near = jnp.square(here[:, 1:] - here[:, :-1]).mean()
    far = jnp.square(here[:, 20:] - here[:, :-20]).mean()
    assert far > 0.6 and near < 0.1 * far


def test_anchors_hold_the_subgoal_space_where_it_was():
    options = config.Representation(
        hidden=(32,), learning_rate=1e-2, batch_size=64, num_updates=200, anchors="rest"
    )
    space = representation.Representation(2, 20, options)
    stored = walks(8, 40)
    state = space.init((8, 40), jax.random.key(0)).replace(num_blocks=jnp.int32(1))
    before = space.place(state.params, stored.obs)

    def drift(stability):
        after, _ = jax.jit(space.train)(state, stored, jnp.float32(stability), jax.random.key(1))
        return float(jnp.square(space.place(after.params, stored.obs) - before).mean())

    assert drift(100.0) < 0.2 * drift(0.0)


def test_novelty_counts_what_comes_after():
    options = config.Exploration(square=1.0, gamma=0.5)
    place = jnp.array([[[0.5, 0.5], [5.5, 0.5]]])
    valid = jnp.ones((1, 2), bool)
    state = exploration.visit(exploration.init(), place, valid, 1.0)
    state = exploration.visit(state, place[:, 1:], valid[:, 1:], 1.0)
    state = exploration.look_ahead(state, place, valid, options)
    i, j = exploration.square(place[0], 1.0)
    # One visit, then half of two: (2 + 1) / (1 + 1). Two visits: (2 + 1) / (1 + 1).
    np.testing.assert_allclose(state.novelty[i, j], [1.5, 1.5])
    assert state.visits.sum() == 3 and state.novelty.max() == 1.5


def test_the_newest_place_within_reach_is_chosen_unless_it_was_missed():
    options = config.Exploration(square=1.0, reach=8.0, miss_weight=1.0)
    candidates = jnp.array([[0.0, 0.0], [3.5, 0.5], [0.5, 6.5], [50.5, 0.5]])
    state = exploration.init()
    i, j = exploration.square(candidates, 1.0)
    state = state.replace(novelty=state.novelty.at[i, j].set(jnp.array([0.0, 5.0, 2.0, 0.1])))
    state = exploration.miss(state, candidates[2:3], jnp.array([4.2]), 1.0)

    def choose(has_potential, here=candidates[0]):
        return exploration.select(
            state, here, candidates, jnp.array(has_potential), options, jax.random.key(0)
        ).tolist()

    assert choose(False) == [0.5, 6.5]
    assert choose(True) == [3.5, 0.5]
    assert choose(True, jnp.array([500.0, 0.0])) in candidates.tolist()


@pytest.mark.parametrize(
    ("miss", "num_blocks", "frozen"), [(1.9, 1, True), (2.1, 1, False), (0.0, 0, False)]
)
def test_a_trained_subgoal_space_is_frozen_once_little_is_missed(miss, num_blocks, frozen):
    options = config.HessConfig(capacity=10, manager=SAC, controller=DDPG)
    learner = learning.Learning(2, 1, 100, 1_000, options)
    learned = jax.jit(learner.init, static_argnums=0)(100, jax.random.key(0))
    learned = learned.replace(space=learned.space.replace(num_blocks=jnp.int32(num_blocks)))
    stored = episodes.init(10, 50, 2, (2, 1))
    args = learned, stored, jnp.int32(51_000), jnp.float32(miss), jax.random.key(1)
    found, _ = jax.jit(learner.train_space)(*args)
    assert bool(found.space.is_frozen) == frozen


class Jump(sled.Sled):
    """Stands in for a robot that is at the goal, one cell east, after a step."""

    def step(self, state, ctrl, walls_xy, is_running):
        return super().step(state, jnp.zeros_like(ctrl).at[0].set(sled.K), walls_xy, is_running)


def small_hess(engine, reward="sparse", **options):
    """Returns HESS in a corridor, with two robots whose episodes have two subgoals."""
    maze = mazes.parse("####\n#S1#\n####\n", num_decisions=4)
    env = goal_maze.GoalMaze(engine(), maze, reward=reward)
    small = config.HessConfig(
        reward=reward,
        num_envs=2,
        period=10,
        capacity=4,
        high_capacity=4,
        manager=config.Sac(hidden=(4,)),
        controller=config.Ddpg(hidden=(4,), critic_hidden=(4,), updates_per_step=0.05),
    )
    return hess.Hess(env, 8, (12, 9), 20, dataclasses.replace(small, **options))


@functools.cache
def rounds(engine, first_step):
    """Returns HESS's states after one and two episodes of two robots.

    From `first_step` on nearly all is explored.
    """
    explores = config.Exploration(first_step=first_step, success_weight=0.0, every=1)
    hess = small_hess(engine, exploration=explores)
    advance = jax.jit(hess.advance)
    first, _ = advance(jax.jit(hess.init)(jax.random.key(0)))
    return first, advance(first)[0]


def test_values_are_bounded_by_the_time_where_goals_are_ends():
    assert small_hess(sled.Stuck)._learning.manager._value_floor == -20.0
    assert small_hess(sled.Stuck, costs_time=False)._learning.manager._value_floor is None
    assert small_hess(sled.Stuck, "dense")._learning.manager._value_floor is None


def test_both_levels_have_learned_with_the_subgoal_space_that_acts():
    trained = config.Representation(hidden=(4,), batch_size=4, num_updates=5, every=40)
    hess = small_hess(sled.Stuck, representation=trained)
    assert hess.steps_per_round == 40
    advance = jax.jit(hess.advance)
    state, metrics = advance(jax.jit(hess.init)(jax.random.key(0)))
    assert state.learned.space.num_blocks == 0 and np.isnan(metrics["representation_loss"])
    state, metrics = advance(state)
    assert state.learned.space.num_blocks == 1 and np.isfinite(metrics["representation_loss"])
    # What was walked last was told with the space as it is now.
    place = hess._learning.space.place(state.learned.space.params, state.episodes.obs[2:])
    np.testing.assert_allclose(place, state.episodes.place[2:], rtol=1e-5, atol=1e-6)


def walked_rows(state):
    rows = replay.sample(state.high_memory, (100,), jax.random.key(0))
    return jax.tree.map(lambda leaf: leaf[rows.is_running], rows.transition)


def test_breaking_down_is_not_worth_arriving():
    rows = walked_rows(rounds(sled.Breaking, 0)[0])
    np.testing.assert_allclose(rows.discount, 0.99)
    np.testing.assert_array_equal(rows.reward, -1.0)
    rows = walked_rows(rounds(Jump, 0)[0])
    np.testing.assert_array_equal(rows.discount, 0.0)
    np.testing.assert_array_equal(rows.reward, 0.0)


def test_no_place_is_novel_before_any_has_been_counted():
    squares = rounds(sled.Stuck, 0)[1].squares
    assert not squares.visits.any() and (squares.novelty == 1.0).all()


def test_only_what_exploration_chose_and_was_walked_for_is_missed():
    assert np.isinf(rounds(sled.Stuck, 1)[0].miss)
    assert rounds(sled.Stuck, 0)[0].miss > 0.0
    assert rounds(Jump, 0)[0].miss == 0.0
