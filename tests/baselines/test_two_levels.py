"""The two-level baselines find their way on open floor, where what it costs is known.

Slow tests, as each compiles for half a minute or more. By default the levels learn each on its own
in `test_probes`, and what joins them is looked at in the tests of their parts.
"""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from eihrl_jax import mazes
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.config import hess, higl, presets
from eihrl_jax.envs import goal_maze
from eihrl_jax.mazes import generators
from eihrl_jax.training import baselines
from tests.envs import sled

FLOOR = "#####\n#SSS#\n#S1S#\n#SSS#\n#####\n"
NUM_DECISIONS = 4
ROUNDS = {"hiro": 120, "hrac": 180, "higl": 90, "hess": 180}
"""Episodes of ten robots, 20 control steps each, that a method needs."""
NUM_SEEDS = 6
"""Most that are tried: one in three gets stuck, which of them is a matter of rounding."""

LEVEL = {"hidden": (64, 64), "critic_decay": 0.0}
FEUDAL = {
    "periods_per_round": NUM_DECISIONS,
    "updates_per_step": 0.5,
    "capacity": 20_000,
    # Noise for the whole reach, and an actor too slow to saturate before the critics know.
    "manager": higl.Td3(reach=3.0, noise=2.0, gamma=0.99, **LEVEL),
    "controller": higl.Td3(
        actor_rate=1e-3, noise=0.3, target_noise=0.1, target_clip=0.3, gamma=0.95, **LEVEL
    ),
    "guidance_weight": 2.0,  # as short episodes are worth little
    "adjacency": higl.Adjacency(steps=4, hidden=(64, 64), period=2_000, max_updates=2_000),
    "landmark_distance": 1.0,
    "landmarks": higl.Landmarks(num_coverage=10, num_novel=5, pool=100, first_step=4_000),
}
EXPLORING = {
    "capacity": 400,
    "random_steps": 4_000,
    "manager": hess.Sac(hidden=(64, 64)),
    "controller": hess.Ddpg(
        hidden=(64, 64), critic_hidden=(64, 64), learning_rate=1e-3, updates_per_step=0.5
    ),
    "representation": hess.Representation(
        hidden=(64,), learning_rate=1e-3, num_updates=2_000, every=2_000
    ),
    "exploration": hess.Exploration(
        first_step=2_000, potential_step=6_000, every=2_000, num_candidates=100, success_weight=1.0
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["higl", "hrac", "hiro", "hess"])
@pytest.mark.usefixtures("optimised")
def test_both_levels_together_learn_to_walk_straight_to_any_goal(method):
    arena = make_arena(method)
    init = jax.jit(arena.baseline.init)
    least, most = (0.85, 9.0) if method == "hess" else (0.95, 7.0)
    outcomes = []
    for seed in range(NUM_SEEDS):
        outcomes.append(train(arena, init(jax.random.key(seed))))
        if outcomes[-1][0] >= least:
            break
    success, steps, state = outcomes[-1]
    assert success >= least, [outcome[:2] for outcome in outcomes]
    # Goals are five steps away on average, and an episode has twenty.
    assert steps <= most
    if method != "hess":
        # Every step costs 0.1, but for the last one; who never arrives pays 2.
        value = start_value(arena.env, arena.baseline, state)
        assert value == pytest.approx(-0.1 * (steps - 1.0), abs=0.3)


def make_arena(method):
    """Returns open floor, on which every place is a start and a goal, with a small baseline."""
    changes = EXPLORING if method == "hess" else FEUDAL
    options = dataclasses.replace(
        presets.BASELINES[method],
        robot="point",
        period=sled.K,
        num_envs=10,
        high_capacity=4_000,
        **changes,
    )
    floor = generators.goals_anywhere(mazes.parse(FLOOR, num_decisions=NUM_DECISIONS))
    env = goal_maze.GoalMaze(sled.Disc(), floor)
    steps = NUM_DECISIONS * sled.K
    baseline = interface.make(World(env, 2, env.side_xy, steps), options)
    return baselines.Arena(method, env, env.side_xy, baseline, steps)


def train(arena, state):
    """Returns how often and in how many steps a trained baseline arrives, and its state."""
    state, _ = arena.advance(state, ROUNDS[arena.title])
    sums = arena.evaluate(arena.baseline.policy(state), jax.random.key(7), 50)
    return float(sums["sum_success"]) / 50, float(sums["sum_steps"]) / 50, state


def start_value(env, baseline, state):
    """Returns the mean of what the manager's first subgoals are worth to it."""
    obs = jax.vmap(env.reset)(jax.random.split(jax.random.key(3), 50)).obs
    features = jax.vmap(baseline._manager_features)(obs)
    level, manager = baseline._learning.manager, state.learned.manager
    subgoal = level.act(manager.actor.params, features)
    return float(jnp.mean(level.values(manager.critics.params, features, subgoal).min(0)))
