"""What HESS is made of: its two levels, episodes, subgoal space and choice of subgoals.

Compilation is nearly all that these tests take: each program is compiled once for all of them.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.agents import replay
from eihrl_jax.baselines.hess import episodes, exploration, hess, learning, levels, representation
from eihrl_jax.baselines.world import World
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
    state = jax.jit(agent.init)(jax.random.key(0))
    batch = transitions(jax.random.key(1), -1.0, 1.0)
    after, _ = jax.jit(agent.update)(state, batch, jnp.ones(64), jnp.float32(0.0))
    for old, new in zip(
        *map(jax.tree.leaves, (state.actor.params, after.actor.params)), strict=True
    ):
        assert jnp.array_equal(old, new)


def stored_episodes():
    """Room for two episodes of up to six steps in periods of three; one is stored, five long."""
    batch = episodes.Episodes(
        obs=jnp.arange(7.0)[None, :, None],
        embedding=jnp.stack([jnp.arange(7.0), -jnp.arange(7.0)], -1)[None],
        action=10.0 * jnp.arange(6.0)[None, :, None],
        subgoal=jnp.array([[[1.0, 1.0], [2.0, 2.0]]]),
        loss=jnp.zeros((1, 6)),
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
    np.testing.assert_array_equal(steps.next_embedding[:, 1], -t - 1)
    np.testing.assert_array_equal(steps.subgoal[:, 0], np.where(t < 3, 1.0, 2.0))


def test_ends_are_those_of_periods_that_there_were():
    obs, is_there = episodes.period_ends(stored_episodes())
    assert obs[0, :, 0].tolist() == [3.0, 6.0]
    assert is_there.tolist() == [[True, True], [False, False]]


def test_the_controller_is_paid_for_the_distance_and_its_task_ends_at_the_subgoal():
    options = config.HessConfig(controller=dataclasses.replace(DDPG, reward_scale=0.1))
    learner = learning.Learning(1, World(None, 1, (3, 3), 10), 100, options)
    steps = episodes.Steps(
        obs=jnp.zeros((3, 1)),
        embedding=jnp.array([[0.0, 0.0], [2.95, 4.0], [3.0, 4.0]]),
        subgoal=jnp.array([[3.0, 4.0]] * 3),
        action=jnp.zeros((3, 1)),
        next_obs=jnp.zeros((3, 1)),
        next_embedding=jnp.array([[3.0, 0.0], [3.0, 3.95], [3.0, 9.0]]),
    )
    row, weight = learner.control_transition(steps)
    np.testing.assert_allclose(row.reward, [-0.4, -0.005, -0.5], rtol=1e-4)
    np.testing.assert_allclose(row.discount, [0.9, 0.0, 0.9], rtol=1e-6)
    assert weight.tolist() == [1.0, 0.0, 0.0]


def on_a_line():
    """Eight episodes that go steadily along a line, seen as two numbers of which one is noise."""
    t = jnp.arange(41.0) / 40
    noise = jax.random.normal(jax.random.key(5), (8, 41))
    seen = jnp.stack([jnp.broadcast_to(t, noise.shape), noise], -1)
    length = jnp.full(8, 40, jnp.int32)
    return episodes.init(8, 20, 2, (2, 1)).replace(obs=seen, length=length)


@functools.cache
def small_space(anchors):
    """Returns a subgoal space, its training, and its state before that."""
    options = config.Representation(
        hidden=(32,), learning_rate=1e-2, batch_size=64, num_updates=200, anchors=anchors
    )
    space = representation.Representation(2, options)
    return space, jax.jit(space.train), space.init(jax.random.key(0))


@pytest.mark.parametrize("anchors", ["best", "rest"])
def test_the_subgoal_space_is_slow_and_spreads_what_is_far_apart(anchors):
    space, train, state = small_space(anchors)
    stored = on_a_line()
    state, _, loss = train(state, stored, jnp.float32(0.1), jax.random.key(1))
    assert state.num_blocks == 1 and loss < 0.6
    here = space.embed(state.network.params, stored.obs)
    near = jnp.square(here[:, 1:] - here[:, :-1]).mean()
    far = jnp.square(here[:, 20:] - here[:, :-20]).mean()
    assert far > 0.6 and near < 0.1 * far


def test_anchors_hold_the_subgoal_space_where_it_was():
    space, train, state = small_space("rest")
    stored, state = on_a_line(), state.replace(num_blocks=jnp.int32(1))
    before = space.embed(state.network.params, stored.obs)

    def drift(stability):
        after, _, _ = train(state, stored, jnp.float32(stability), jax.random.key(1))
        return float(jnp.square(space.embed(after.network.params, stored.obs) - before).mean())

    assert drift(100.0) < 0.2 * drift(0.0)


def test_novelty_counts_what_comes_after():
    options = config.Exploration(square=1.0, gamma=0.5)
    embedding = jnp.array([[[0.5, 0.5], [5.5, 0.5]]])
    state = exploration.init()
    visits = exploration.add(state.visits, embedding, jnp.ones((1, 2)), 1.0)
    visits = exploration.add(visits, embedding[:, 1:], jnp.ones((1, 1)), 1.0)
    state = state.replace(visits=visits)
    state = exploration.look_ahead(state, embedding, jnp.ones((1, 2), bool), options)
    i, j = exploration.square(embedding[0], 1.0)
    # One visit, then half of two: (2 + 1) / (1 + 1). Two visits: (2 + 1) / (1 + 1).
    np.testing.assert_allclose(state.novelty[i, j], [1.5, 1.5])
    assert state.visits.sum() == 3 and state.novelty.max() == 1.5


def test_the_newest_place_within_reach_is_chosen_unless_it_was_missed():
    options = config.Exploration(square=1.0, reach=8.0, miss_weight=1.0)
    candidates = jnp.array([[0.0, 0.0], [3.5, 0.5], [0.5, 6.5], [50.5, 0.5]])
    state = exploration.init()
    i, j = exploration.square(candidates, 1.0)
    state = state.replace(novelty=state.novelty.at[i, j].set(jnp.array([0.0, 5.0, 2.0, 0.1])))
    misses = exploration.add(state.misses, candidates[2:3], jnp.array([4.2]), 1.0)
    state = state.replace(misses=misses)

    def choose(has_potential, here=candidates[0]):
        return exploration.select(
            state, here, candidates, jnp.array(has_potential), options, jax.random.key(0)
        ).tolist()

    assert choose(False) == [0.5, 6.5]
    assert choose(True) == [3.5, 0.5]
    assert choose(True, jnp.array([500.0, 0.0])) in candidates.tolist()


def small_hess(engine, reward="sparse", **options):
    """Returns HESS in a corridor, with two robots whose episodes have two subgoals.

    From the first step on nearly all is explored, and the subgoal space is trained every 80.
    """
    maze = mazes.parse("####\n#S1#\n####\n", num_decisions=4)
    env = goal_maze.GoalMaze(engine, maze, reward=reward)
    small = config.HessConfig(
        reward=reward,
        num_envs=2,
        period=10,
        capacity=4,
        high_capacity=4,
        manager=config.Sac(hidden=(4,)),
        controller=config.Ddpg(hidden=(4,), critic_hidden=(4,), updates_per_step=0.05),
        representation=config.Representation(hidden=(4,), batch_size=4, num_updates=5, every=80),
        exploration=config.Exploration(first_step=1, success_weight=0.0, every=1),
    )
    return hess.Hess(World(env, 2, (12, 9), 20), dataclasses.replace(small, **options))


@functools.cache
def puppets():
    """Returns HESS whose robots are puppets, and two rounds of it.

    The rounds go from what the robots do and the steps taken before to states and metrics.
    """
    puppet = sled.Puppet()
    agent = small_hess(puppet)

    @jax.jit
    def play(deed, num_steps):
        puppet.deed = deed

        def body(state, _):
            state, metrics = agent.advance(state)
            return state, (state, metrics)

        start = agent.init(jax.random.key(0)).replace(num_steps=num_steps)
        return jax.lax.scan(body, start, length=2)[1]

    return agent, play


@functools.cache
def rounds(deed, num_steps):
    """Returns HESS's state and metrics after one and after two episodes of two robots."""
    both = puppets()[1](jnp.int32(deed), jnp.int32(num_steps))
    return jax.tree.map(lambda leaf: leaf[0], both), jax.tree.map(lambda leaf: leaf[1], both)


def test_values_are_bounded_by_the_time_where_goals_are_ends():
    engine = sled.Disc()
    assert small_hess(engine)._learning.manager.value_floor == -20.0
    assert small_hess(engine, costs_time=False)._learning.manager.value_floor is None
    assert small_hess(engine, "dense")._learning.manager.value_floor is None


def test_both_levels_have_learned_with_the_subgoal_space_that_acts():
    agent, _ = puppets()
    assert agent.steps_per_round == 40
    (state, metrics), (next_state, next_metrics) = rounds(sled.Deed.REST, 40)
    assert state.learned.space.num_blocks == 0 and np.isnan(metrics["representation_loss"])
    assert next_state.learned.space.num_blocks == 1
    assert np.isfinite(next_metrics["representation_loss"])
    # What was visited last was embedded with the space as it is now.
    stored = next_state.episodes
    embedding = agent._learning.space.embed(next_state.learned.space.network.params, stored.obs[2:])
    np.testing.assert_allclose(embedding, stored.embedding[2:], rtol=1e-5, atol=1e-6)


def rows_that_count(state):
    rows = replay.sample(state.high_replay, (100,), jax.random.key(0))
    return jax.tree.map(lambda leaf: leaf[rows.is_running], rows.transition)


def test_breaking_down_is_not_worth_arriving():
    rows = rows_that_count(rounds(sled.Deed.BREAK, 1)[0][0])
    np.testing.assert_allclose(rows.discount, 0.99)
    np.testing.assert_array_equal(rows.reward, -1.0)
    rows = rows_that_count(rounds(sled.Deed.JUMP, 1)[0][0])
    np.testing.assert_array_equal(rows.discount, 0.0)
    np.testing.assert_array_equal(rows.reward, 0.0)


def test_no_square_is_novel_before_any_has_been_counted():
    squares = rounds(sled.Deed.REST, 1)[1][0].squares
    assert not squares.visits.any() and (squares.novelty == 1.0).all()


def test_only_what_exploration_chose_and_was_gone_for_is_missed():
    assert np.isinf(rounds(sled.Deed.REST, 0)[0][0].miss)
    assert rounds(sled.Deed.REST, 1)[0][0].miss > 0.0
    assert rounds(sled.Deed.JUMP, 1)[0][0].miss == 0.0


@functools.cache
def small_training():
    """Returns the training of a subgoal space where it is due, and a state in which it isn't."""
    agent, _ = puppets()
    return jax.jit(agent._learning.train_space), rounds(sled.Deed.REST, 0)[0][0]


@pytest.mark.parametrize(
    ("miss", "num_blocks", "frozen"), [(1.9, 1, True), (2.1, 1, False), (0.0, 0, False)]
)
def test_a_trained_subgoal_space_is_frozen_once_little_is_missed(miss, num_blocks, frozen):
    train, state = small_training()
    space = state.learned.space.replace(num_blocks=jnp.int32(num_blocks))
    state = state.replace(learned=state.learned.replace(space=space), miss=jnp.float32(miss))
    state, loss = train(state, jax.random.key(1))
    assert bool(state.learned.space.is_frozen) == frozen and np.isnan(loss)
