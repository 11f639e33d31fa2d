"""Brax's PPO and SAC as baselines: held between rows, resumed as far as they can be."""

import csv
import dataclasses
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes, robots
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.brax import MazeEnv, agents, learners, rows
from eihrl_jax.config import brax as brax_config
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import presets
from eihrl_jax.reporting import evaluations
from eihrl_jax.training import baselines

MAZE = "####\n#1S#\n####\n"
SMALL = {
    "robot": "point",
    "num_decisions": 2,
    "num_envs": 2,
    "hidden": (8, 8),
    "log_rounds": 1,
    "num_eval_episodes": 2,
}
OPTIONS = {
    "ppo": {"batch_size": 2, "num_minibatches": 2, "unroll_length": 10, "num_steps": 320},
    "sac": {"batch_size": 4, "grad_updates_per_step": 1, "warmup_steps": 30, "num_steps": 320},
}


def config_of(method, **changes):
    return dataclasses.replace(presets.BASELINES[method], **SMALL | OPTIONS[method] | changes)


def counting(tell):
    for i in range(2):
        tell(i)
    raise base.UserError("that is all")


def test_rows_are_told_one_by_one_and_errors_come_out():
    told = rows.Rows(counting)
    assert [told.next(), told.next()] == [0, 1]
    with pytest.raises(base.UserError, match="that is all"):
        told.next()
    told.close()


def test_work_that_is_closed_ends_where_it_rests():
    ended, did = [], []

    def work(tell):
        try:
            tell(0)
            did.append("went on")
        finally:
            ended.append(True)

    told = rows.Rows(work)
    told.close()  # nothing has begun
    told = rows.Rows(work)
    assert told.next() == 0
    told.close()
    assert ended == [True] and not did


@pytest.fixture(scope="module")
def world():
    env = MazeEnv(mazes.parse(MAZE, num_decisions=2), "point").bare
    steps = 2 * robots.load("point").steps_per_subgoal
    return World(env, 2, env.side_xy, steps)


@pytest.mark.parametrize("method", ["ppo", "sac"])
def test_an_agent_acts_as_brax_does_with_what_it_was_given(method, world):
    agent = interface.make(world, config_of(method))
    assert isinstance(agent, interface.RowLearner) and not isinstance(agent, interface.Baseline)
    state = agent.init(jax.random.key(0))
    normaliser, policy = learners.for_brax(state.params)
    normaliser = normaliser.replace(mean=normaliser.mean + 1.0, std=normaliser.std * 2.0)
    params = [normaliser, policy, *([state.params["value"]] if method == "ppo" else [])]
    state = agents.AgentState(learners.from_brax(params), jnp.int32(5))
    # As it was, names and shapes, so that a checkpoint of it is one of the other.
    assert jax.tree.structure(state) == jax.tree.structure(agent.init(jax.random.key(1)))

    obs = jax.jit(world.env.reset)(jax.random.key(0)).obs
    ctrl, carry = agent.act(agent.policy(state), agent.start(), obs)
    networks = agent._networks
    logits = networks.policy_network.apply(normaliser, policy, agent.see(obs))
    expected = networks.parametric_action_distribution.mode(logits)
    np.testing.assert_array_equal(ctrl, expected)
    assert carry == () and ctrl.shape == (2,) and (abs(ctrl) < 1.0).all()
    # What it sees is what it learns from.
    env = MazeEnv.of(world.env)
    np.testing.assert_array_equal(agent.see(obs), env.see(obs))


def test_what_does_not_fit_is_one_line(monkeypatch, world):
    with pytest.raises(base.UserError, match=r"num_envs = 3 must divide batch_size \* num_mini"):
        config_of("ppo", num_envs=3)
    with pytest.raises(base.UserError, match="warmup_steps = 30 .* capacity = 20"):
        config_of("sac", capacity=20)
    monkeypatch.delitem(sys.modules, "eihrl_jax.brax.agents")
    monkeypatch.delitem(sys.modules, "eihrl_jax.brax")
    monkeypatch.setitem(sys.modules, "brax", None)
    with pytest.raises(base.UserError, match="method = 'sac' needs Brax: pip install"):
        interface.make(world, config_of("sac"))


def test_sac_waits_for_its_replay_in_whole_rows():
    options = config_of("sac", warmup_steps=41)
    assert isinstance(options, brax_config.SacConfig)
    assert (options.steps_per_round, options.warmup_rows) == (20, 3)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ppo", "sac"])
def test_a_run_is_trained_resumed_and_evaluated(method, tmp_path):
    maze, run = tmp_path / "corridor.txt", tmp_path / method
    maze.write_text(MAZE)
    options = config_of(method, maze=str(maze), run=run)
    baselines.train(dataclasses.replace(options, num_steps=160))
    first = (run / "metrics.csv").read_text()
    baselines.train(dataclasses.replace(options, resume=True))
    assert (run / "metrics.csv").read_text().startswith(first)

    with (run / "metrics.csv").open() as file:
        table = list(csv.DictReader(file))
    assert int(table[-1]["step"]) == 320 and 0.0 <= float(table[-1]["eval/success"]) <= 1.0
    assert np.isfinite(
        float(table[-1]["learner/actor_loss" if method == "sac" else "learner/v_loss"])
    )
    # An episode has 50 steps at most, and either half of the run began with new ones.
    assert 2 <= sum(float(row["episodes"]) for row in table) <= 32

    cells = evaluations.evaluate(
        evaluate_config.EvaluateConfig(
            mazes=(str(maze),),
            robot=("point",),
            movement=("full",),
            high=(str(run),),
            episodes=2,
            animate="none",
            out=tmp_path / "evaluation",
        )
    ).cells
    assert [cell.num_episodes for cell in cells] == [2]
