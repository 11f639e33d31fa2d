"""What HIGL is made of: adjacency, novelty, the off-policy correction, the planner.

Compilation is nearly all that these tests take: each program is compiled once for all of them.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.agents import optimisation, replay
from eihrl_jax.baselines.actor_critic import ActorCriticState
from eihrl_jax.baselines.higl import adjacency, higl, landmarks, learning, novelty, relabelling
from eihrl_jax.baselines.world import World
from eihrl_jax.config import higl as config
from eihrl_jax.envs import goal_maze
from tests.envs import sled

NO = jnp.zeros((6, 1), bool)
YES = ~NO
LINE = jnp.stack([jnp.arange(6.0) - 2.5, jnp.zeros(6)], -1)[:, None]
"""A robot's way from west to east along squares 0 to 5 of an arena of 6 x 1 units."""


def places(**options):
    settings = {"steps": 2, "hidden": (32, 32), "num_features": 8, "learning_rate": 2e-3}
    return adjacency.AdjacencyNetwork(1, 6, config.Adjacency(**(settings | options)))


def test_places_within_a_few_steps_of_each_other_are_adjacent():
    network = places()
    table = network.mark(network.init(jax.random.key(0)), LINE, YES, NO).table
    i, j = np.indices((6, 6))
    np.testing.assert_array_equal(table, abs(i - j) <= 2)


def test_places_of_different_episodes_are_not_adjacent():
    network = places()
    is_end = NO.at[2, 0].set(True)
    table = np.asarray(network.mark(network.init(jax.random.key(0)), LINE, YES, is_end).table)
    assert table[1, 2] and table[3, 4] and not table[:3, 3:].any()
    stopped = YES.at[2, 0].set(False)  # The end itself doesn't count where a simulation broke down.
    table = np.asarray(network.mark(network.init(jax.random.key(0)), LINE, stopped, is_end).table)
    assert table[0, 1] and table[3, 4] and not table[:3, 3:].any()
    is_running = YES.at[3, 0].set(False)
    table = np.asarray(network.mark(network.init(jax.random.key(0)), LINE, is_running, NO).table)
    assert not table[3].any() and table[2, 4]


def test_a_maze_too_large_for_the_table_is_named():
    with pytest.raises(base.UserError, match=r"300 x 200 unit squares, must be at most 32768"):
        adjacency.AdjacencyNetwork(300, 200, config.Adjacency())
    options = config.HiglConfig(method="hiro", guidance="none")
    learner = learning.Learning(4, World(None, 2, (200, 300), 10), options)
    assert jax.eval_shape(learner.init, jax.random.key(0)).places.table.shape == (1, 1)


def test_the_network_learns_what_is_adjacent():
    network = places(epochs=2000, max_updates=2000)
    state = network.mark(network.init(jax.random.key(0)), LINE, YES, NO)
    state, loss = jax.jit(network.fit)(state, jax.random.key(1))
    assert loss < 0.02
    here = jnp.broadcast_to(LINE[:1, 0], (6, 2))
    excess = np.asarray(network.excess(state.network.params, here, LINE[:, 0]))
    assert (excess[:3] == 0.0).all() and (excess[3:] > 0.0).all()


def test_the_most_novel_places_are_kept_until_they_are_visited_again():
    options = config.Landmarks(num_novel=3, merge_radius=0.5, novelty_hidden=(16,))
    new = novelty.Novelty(2, options)
    state = new.init(jax.random.key(0))
    obs = jnp.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]])
    state = new.visit(state, obs, jnp.ones(3, bool))
    assert sorted(state.obs.tolist()) == sorted(obs.tolist())
    often = jnp.broadcast_to(jnp.array([[[0.0, 4.0]]]), (1000, 1, 2))
    state, loss = jax.lax.scan(new.update, state, often)
    assert loss[-1] < 0.05 * loss[0]
    before = {tuple(xy): score for xy, score in zip(state.obs.tolist(), state.score, strict=True)}
    state = new.visit(state, obs[2:3], jnp.ones(1, bool))
    after = {tuple(xy): score for xy, score in zip(state.obs.tolist(), state.score, strict=True)}
    assert after[(0.0, 4.0)] < 0.1 * before[(0.0, 4.0)]
    assert after[(0.0, 0.0)] == before[(0.0, 0.0)]
    unseen = new.visit(new.init(jax.random.key(0)), obs, jnp.zeros(3, bool))
    assert not np.isfinite(unseen.score).any()


def test_a_way_of_small_steps_leaves_its_most_novel_places_apart():
    options = config.Landmarks(num_novel=3, merge_radius=0.5, novelty_hidden=(16,))
    new = novelty.Novelty(2, options)
    state = new.init(jax.random.key(0))
    way = jnp.stack([0.2 * jnp.arange(20.0), jnp.zeros(20)], axis=1)
    found = new.visit(state, way, jnp.ones(20, bool))
    assert np.isfinite(found.score).all()
    apart = np.linalg.norm(found.obs[:, None] - found.obs[None], axis=-1) + np.eye(3)
    assert apart.min() >= 0.5
    alone = [new.visit(state, xy[None], jnp.ones(1, bool)).score[0] for xy in way]
    assert found.score[0] == pytest.approx(max(alone))


@functools.cache
def puppets():
    """Returns a round of HIRO's robots, from what they do to its state after it.

    Beside it stand the rewards that the manager is paid, by whether time costs something.
    """
    puppet = sled.Puppet()
    env = goal_maze.GoalMaze(puppet, mazes.parse("####\n#S1#\n####\n", num_decisions=2))
    options = config.HiglConfig(
        method="hiro",
        guidance="none",
        num_envs=2,
        period=5,
        periods_per_round=2,
        manager=config.Td3(hidden=(4,), reach=10.0),
        controller=config.Td3(hidden=(4,)),
        capacity=20,
        high_capacity=4,
    )
    world = World(env, puppet.model.nu, (12, 9), 10)
    costly, free = (
        higl.Higl(world, dataclasses.replace(options, costs_time=costs)) for costs in (True, False)
    )

    @jax.jit
    def play(deed):
        puppet.deed = deed
        state, period = costly._collect(costly.init(jax.random.key(0)), jax.random.key(1))
        rows = replay.sample(state.high_replay, (100,), jax.random.key(0))
        return state, {True: rows.reward, False: free._rows(period)[1].reward}

    return play


@functools.cache
def after_a_round(deed):
    """Returns HIRO's state after two subgoals of two robots, and what its manager is paid."""
    return puppets()(jnp.int32(deed))


@pytest.mark.parametrize("costs_time", [False, True])
def test_the_manager_is_paid_per_control_step_as_released(costs_time):
    _, rewards = after_a_round(sled.Deed.REST)
    # Nobody arrives: nothing is paid but the time.
    assert set(rewards[costs_time].ravel().tolist()) == {-5.0 if costs_time else 0.0}


@pytest.mark.parametrize(("deed", "counts"), [(sled.Deed.REST, True), (sled.Deed.BREAK, False)])
def test_the_controller_does_not_learn_to_break_down(deed, counts):
    state, _ = after_a_round(deed)
    steps = replay.sample(state.low_replay, (100,), jax.random.key(0))
    assert (steps.is_running == counts).all()


def test_a_subgoal_stays_one_place_while_the_robot_goes_towards_it():
    state, _ = after_a_round(sled.Deed.MOVE)
    rows = replay.sample(state.low_replay, (400,), jax.random.key(0))
    xy = rows.obs[:, :2]
    # Two robots had two subgoals each, and moved.
    assert num_distinct(xy[:, 0] + rows.subgoal[:, 0]) == 4
    assert num_distinct(xy[:, 0]) > 10


def num_distinct(numbers):
    return 1 + int((jnp.diff(jnp.sort(numbers)) > 1e-3).sum())


def subgoal_row(subgoal):
    """A controller that goes a tenth of the displacement left per step, for five steps."""
    xy, obs, action = jnp.zeros(2), [], []
    for _ in range(5):
        obs.append(xy)
        action.append(0.1 * (subgoal - xy))
        xy = xy + action[-1]
    return relabelling.SubgoalRow(
        obs=jnp.stack(obs),
        action=jnp.stack(action),
        is_running=jnp.ones(5, bool),
        subgoal=jnp.array([-9.0, 9.0]),
        goal_xy=jnp.zeros(2),
        reward=jnp.float32(0.0),
        next_obs=xy,
        next_goal_xy=jnp.zeros(2),
        terminated=jnp.array(False),
        truncated=jnp.array(False),
    )


def test_the_correction_finds_the_subgoal_that_explains_what_was_done():
    row, wanted = subgoal_row(jnp.array([4.0, 1.0])), np.array([4.0, 1.0])

    def act(seen, left):
        return 0.1 * left

    found = relabelling.correct(row, act, 10.0, 2000, jax.random.key(0))
    assert np.linalg.norm(found - wanted) < 0.5
    few = relabelling.correct(row, act, 10.0, 2, jax.random.key(0))
    np.testing.assert_allclose(few, row.next_obs)  # what was achieved beats what was stored
    kept = relabelling.correct(row, act, 10.0, 1, jax.random.key(0))
    np.testing.assert_array_equal(kept, row.subgoal)
    told = row.replace(subgoal=jnp.asarray(wanted, jnp.float32))
    np.testing.assert_allclose(relabelling.correct(told, act, 10.0, 12, jax.random.key(0)), wanted)


class Goer:
    """Stands in for the controller: a way is worth minus its length."""

    def act(self, actor_params, features):
        del actor_params
        return features[..., -2:]

    def values(self, critic_params, features, action):
        del critic_params, action
        length = jnp.sqrt(jnp.square(features[..., -2:]).sum(-1))
        return jnp.stack([-length, -length + 1.0])


TRAINED = optimisation.TrainState(params=None, opt_state=None)
CONTROLLER = ActorCriticState(TRAINED, TRAINED, None, None, None)


def lead(planner, graph, obs, goal_xy):
    """Returns where to go from each place on the way to its goal."""
    ways = planner.ways(graph, goal_xy)
    return planner.plan(graph, obs, goal_xy, ways)


@pytest.mark.parametrize(("near", "then"), [(-2.0, [10.0, 5.0]), (-20.0, [10.0, 9.0])])
def test_the_planner_leads_along_the_landmarks(near, then):
    options = config.Landmarks(
        num_coverage=4, num_novel=2, pool=4, cutoff=-6.0, near=near, heat=5.0, rounds=4
    )
    planner = landmarks.Planner(Goer(), CONTROLLER, options)
    pool = jnp.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [10.0, 5.0]])
    new = novelty.Novelty(2, options).init(jax.random.key(0))
    graph = jax.jit(planner.graph)(pool, new)
    assert graph.is_valid.tolist() == [True] * 4 + [False] * 2
    goal = jnp.array([[10.0, 9.0]])

    plan_for = jax.jit(lambda xy: lead(planner, graph, xy[None], goal)[0])

    def plan(x, y):
        return plan_for(jnp.array([x, y])).tolist()

    assert plan(1.0, 0.5) == [5.0, 0.0]
    assert plan(9.0, 4.5) == then  # the goal lies within the cutoff
    assert plan(9.0, 2.5) == [10.0, 5.0]  # the goal lies beyond the cutoff, whatever is near
    assert plan(10.0, 8.0) == [10.0, 9.0]  # near enough to go there itself


@functools.cache
def square(num_first=24):
    """Returns sixty places in a square of twenty units, a graph of them, and how it leads."""
    options = config.Landmarks(num_coverage=30, num_novel=1, pool=60, num_first=num_first)
    options = dataclasses.replace(options, cutoff=-6.0, near=-2.0, heat=5.0)
    planner = landmarks.Planner(Goer(), CONTROLLER, options)
    pool = jax.random.uniform(jax.random.key(1), (60, 2), maxval=20.0)
    new = novelty.Novelty(2, options).init(jax.random.key(0))
    graph = jax.jit(planner.graph)(pool, new) if num_first == 24 else square()[1]
    return pool, graph, jax.jit(lambda obs, goal_xy: lead(planner, graph, obs, goal_xy))


def test_many_goals_are_planned_for_as_each_alone():
    pool, _, lead = square()
    goals = jax.random.uniform(jax.random.key(2), (60, 2), maxval=20.0)
    all_at_once = lead(pool, goals)
    for some in (slice(0, 30), slice(30, 60)):
        np.testing.assert_allclose(lead(pool[some], goals[some]), all_at_once[some])
    repeated = lead(pool, goals[jnp.arange(60) % 3])
    for i in range(60):
        alone = lead(pool[i : i + 1], goals[i % 3][None])
        np.testing.assert_allclose(repeated[i], alone[0])


def test_batches_are_led_as_one_plan_leads():
    # Places are planned for a few at a time, each with its own goal's ways.
    options = config.Landmarks(num_coverage=6, num_novel=1, pool=60, cutoff=-6.0, near=-2.0)
    planner = landmarks.Planner(Goer(), CONTROLLER, options)
    new = novelty.Novelty(2, options).init(jax.random.key(0))
    pool = jax.random.uniform(jax.random.key(1), (60, 2), maxval=20.0)
    goals = jax.random.uniform(jax.random.key(2), (60, 2), maxval=20.0)
    batches = pool.reshape(3, 20, 2), goals.reshape(3, 20, 2)
    led = jax.jit(planner.lead)(new, pool[None], *batches)
    one = jax.jit(lambda: lead(planner, planner.graph(pool, new), pool, goals))()
    np.testing.assert_allclose(led.reshape(60, 2), one)


def test_the_first_landmark_is_among_the_nearest():
    pool, graph, _ = square()
    landmark_xy = graph.obs[graph.is_valid]
    goals = jax.random.uniform(jax.random.key(2), (60, 2), maxval=20.0)
    every, more, fifteen, one = (square(num)[2](pool, goals) for num in (31, 100, 15, 1))
    apart = jnp.sqrt(jnp.square(every - pool).sum(-1))
    assert (apart > 3.0).sum() > 20
    np.testing.assert_array_equal(more, every)
    np.testing.assert_array_equal(fifteen, every)  # more than lie within the cutoff
    nearest = jnp.square(landmark_xy[None] - pool[:, None]).sum(-1).argmin(1)
    near_goal = jnp.square(goals - pool).sum(-1, keepdims=True) < 4.0
    expected = jnp.where(near_goal, goals, landmark_xy[nearest])
    np.testing.assert_array_equal(one, expected)


@pytest.mark.parametrize("moved", [False, True])
def test_the_controller_is_paid_for_the_distance_left(moved):
    options = config.HiglConfig(stores_moved_subgoal=moved)
    world = World(None, 2, (9, 9), 10)
    learner = learning.Learning(4, world, options)
    row = learning.ControlRow(
        obs=jnp.array([1.0, 2.0, 7.0, 8.0]),
        subgoal=jnp.array([3.0, 0.0]),
        action=jnp.zeros(2),
        reward=jnp.float32(-2.0),
        next_obs=jnp.array([2.0, 2.0, 7.5, 8.5]),
        is_end=jnp.array(True),
        is_running=jnp.array(True),
    )
    transition = learner.control_transition(row)
    assert transition.obs.tolist() == [7.0, 8.0, 3.0, 0.0]
    assert transition.next_obs.tolist() == [7.5, 8.5, 2.0, 0.0]
    assert transition.discount == pytest.approx(0.95)  # its task goes on when the episode ends
    quirky = dataclasses.replace(options, is_limit_terminal=True)
    assert learning.Learning(4, world, quirky).control_transition(row).discount == 0.0
