"""What HIGL's manager is taught from what is stored: ends, the way ahead, what holds subgoals."""

import functools
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.agents import optimisation, replay
from eihrl_jax.baselines.higl import adjacency, landmarks, learning, relabelling
from eihrl_jax.baselines.world import World
from eihrl_jax.config import higl as config

LEVEL = {"hidden": (8,), "batch_size": 4}
SEEN = 5
OBS = np.ones((20, SEEN), np.float32)

PLACES = adjacency.AdjacencyState(optimisation.TrainState(None, None), None)
UNTRAINED = learning.Learned(None, None, PLACES, None)
"""Stands in for what is learned where nothing is asked of it."""


def make(guidance="landmarks", **options):
    """Returns the functions that learn, of small networks in an arena of nine units."""
    options = config.HiglConfig(
        method={"landmarks": "higl", "adjacency": "hrac"}[guidance],
        guidance=guidance,
        num_envs=2,
        period=5,
        periods_per_round=2,
        capacity=20,
        high_capacity=4,
        manager=config.Td3(reach=10.0, **LEVEL),
        controller=config.Td3(gamma=0.95, **LEVEL),
        **options,
    )
    return learning.Learning(SEEN, World(None, 2, (9, 9), 50), options)


def subgoals(num=4, **fields):
    """Returns stored subgoals of one step each, drawn from a key."""
    obs_key, goal_key = jax.random.split(jax.random.key(5))
    stored = relabelling.SubgoalRow(
        obs=jax.random.uniform(obs_key, (num, 5, SEEN)),
        action=jnp.zeros((num, 5, 2)),
        is_running=jnp.ones((num, 5), bool),
        subgoal=jnp.ones((num, 2)),
        goal_xy=jax.random.uniform(goal_key, (num, 2), minval=-4.0, maxval=4.0),
        reward=-5.0 * jnp.ones(num),
        next_obs=jnp.ones((num, SEEN)),
        next_goal_xy=jnp.ones((num, 2)),
        terminated=jnp.zeros(num, bool),
        truncated=jnp.zeros(num, bool),
    )
    return stored.replace(**fields)


@pytest.mark.parametrize(("is_end", "at_the_limit"), [(False, 0.99), (True, 0.0)])
def test_a_time_limit_ends_the_managers_task_where_asked(is_end, at_the_limit):
    learner = make(is_limit_terminal=is_end)
    ends = jnp.array([False, True, False]), jnp.array([False, False, True])
    rows = subgoals(3, terminated=ends[0], truncated=ends[1])
    controller = jax.jit(learner.controller.init)(jax.random.key(0))
    transition = jax.jit(learner.subgoal_transition)(controller, rows, jax.random.key(1))
    np.testing.assert_allclose(transition.discount, [0.99, 0.0, at_the_limit], rtol=1e-6)
    np.testing.assert_allclose(transition.reward, [-0.5] * 3, rtol=1e-6)


def run_after(num_steps, learned, low_replay=None, high_replay=None):
    """Returns the state of a run after so many control steps."""
    key = jax.random.key(0)
    return learning.HiglState(learned, low_replay, high_replay, None, key, jnp.int32(num_steps))


def control_rows(obs):
    """Returns twenty stored steps that saw `obs`."""
    return learning.ControlRow(
        obs=obs,
        subgoal=jnp.ones((20, 2)),
        action=jnp.zeros((20, 2)),
        reward=-jnp.ones(20),
        next_obs=obs,
        is_end=jnp.zeros(20, bool),
        is_running=jnp.ones(20, bool),
    )


def stored(rows):
    """Returns a replay that holds these rows."""
    return replay.add(replay.init(replay.row(rows), rows.reward.shape[0]), rows)


@pytest.mark.parametrize(("num_steps", "step"), [(99, [0.0, 0.0]), (100, [1.2, 1.6])])
def test_the_way_ahead_is_a_step_towards_the_landmark(num_steps, step, monkeypatch):
    early = config.Landmarks(pool=20, first_step=100)
    learner, hrac = make(landmark_distance=2.0, landmarks=early), make(guidance="adjacency")
    rows = jax.tree.map(lambda leaf: leaf[None], subgoals())
    here_xy = rows.obs[:, :, 0, :2]
    monkeypatch.setattr(landmarks.Planner, "lead", lambda *_: here_xy + jnp.array([[[3.0, 4.0]]]))
    state = run_after(num_steps, UNTRAINED, stored(control_rows(OBS)))
    ahead_xy = learner._ahead(state, rows, jax.random.key(1))
    np.testing.assert_allclose(ahead_xy - here_xy, [[step] * 4], atol=1e-5)
    # HRAC has no landmarks: its subgoals are held to what is adjacent to here.
    np.testing.assert_array_equal(hrac._ahead(state, rows, jax.random.key(1)), here_xy)


def test_subgoals_are_held_by_how_far_they_lie_from_the_way_ahead(monkeypatch):
    learner = make(guidance_weight=20.0)
    limit = 1.5
    apart = types.SimpleNamespace(
        excess=lambda _, a, b: jnp.maximum(jnp.linalg.norm(a - b, axis=-1) - limit, 0.0)
    )
    monkeypatch.setattr(learner, "_adjacency", apart)
    here_xy, ahead_xy = jnp.ones((2, 2)), jnp.array([[1.0, 1.0], [1.0, 3.0]])
    penalty = learner._penalty(UNTRAINED.places, here_xy, ahead_xy)
    subgoal = jnp.array([[3.0, 4.0], [0.0, 1.0]])
    # Five units beyond the first way ahead, one short of the second.
    np.testing.assert_allclose(penalty(subgoal), 20.0 * (5.0 - limit) / 2.0, rtol=1e-6)


@functools.cache
def led(per_update):
    """Returns what learns with landmarks, and its state at the start."""
    numbers = {"num_coverage": 2, "num_novel": 2, "pool": 4, "rounds": 2, "novelty_hidden": (8,)}
    numbers |= {"near": 0.0}  # No goal is followed itself.
    learner = make(landmarks=config.Landmarks(per_update=per_update, **numbers))
    learned = jax.jit(learner.init)(jax.random.key(0))
    # Embeddings so far apart that subgoals are held.
    network = learned.places.network
    network = network.replace(params=jax.tree.map(lambda leaf: 10.0 * leaf, network.params))
    return jax.jit(learner._learn_manager), learned.replace(
        places=learned.places.replace(network=network)
    )


def taught(per_update, obs):
    """Returns the manager after a round on steps that saw `obs`."""
    learn, learned = led(per_update)
    state = run_after(60_000, learned, stored(control_rows(obs)), stored(subgoals()))
    manager, _ = learn(state, jax.random.key(1))
    return jax.tree.leaves(manager.actor.params)


def test_landmarks_made_for_each_update_are_those_of_the_round_where_there_is_one_place():
    for per_round, per_update in zip(taught(False, OBS), taught(True, OBS), strict=True):
        np.testing.assert_allclose(per_round, per_update, atol=1e-5)
    spread = 8.0 * jax.random.uniform(jax.random.key(2), (20, SEEN)) - 4.0
    pairs = zip(taught(False, spread), taught(True, spread), strict=True)
    assert max(float(jnp.abs(a - b).max()) for a, b in pairs) > 1e-5
