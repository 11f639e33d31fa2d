"""Every baseline trains, resumes exactly, compiles once, and is evaluated beside ours.

Here flat DroQ does; files of their own take these tests for the other methods, so that they run at
the same time.
"""

import csv
import dataclasses
import math

import jax
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import higl as higl_config
from eihrl_jax.config import low as low_config
from eihrl_jax.config import presets
from eihrl_jax.reporting import evaluations
from eihrl_jax.runs import checkpoint, policies
from eihrl_jax.training import baselines

MAZE = "####\n#1S#\n####\n"
ALL_METHODS = tuple(presets.BASELINES)
METHODS = ("droq",)


def pytest_generate_tests(metafunc):
    """Puts the methods of a file to the tests that it holds."""
    if "conforming" in metafunc.fixturenames:
        metafunc.parametrize("conforming", metafunc.module.METHODS, scope="module")


def test_options_are_of_their_method():
    for options in presets.BASELINES.values():
        kind = type(options)
        assert kind().method in ALL_METHODS
        with pytest.raises(base.UserError, match="method = 'dqn' must be one of"):
            kind(method="dqn")
    with pytest.raises(base.UserError, match="method = 'hess' must be one of higl, hrac, hiro"):
        dataclasses.replace(presets.BASELINES["higl"], method="hess")


def small_options(method):
    """Options under which a method does everything that it does, in little time."""
    if method == "droq":
        return {
            "warmup_steps": 8,
            "iterations_per_round": 4,
            "updates_per_step": 1,
            "capacity": 400,
            "learner": low_config.Droq(hidden=(16, 16), actor_period=2, batch_size=8),
        }
    if method == "hess":
        return {
            "period": 10,
            "capacity": 8,
            "high_capacity": 400,
            "random_steps": 100,
            "manager": hess_config.Sac(hidden=(16, 16), batch_size=8),
            "controller": hess_config.Ddpg(
                hidden=(16,), critic_hidden=(16,), batch_size=8, updates_per_step=0.04
            ),
            "representation": hess_config.Representation(
                hidden=(8,), batch_size=8, num_updates=3, every=100
            ),
            "exploration": hess_config.Exploration(
                num_candidates=8, first_step=100, potential_step=200, every=100
            ),
        }
    if method in ("ppo", "sac"):
        small = {"batch_size": 2, "hidden": (8,)}
        own = (
            {"num_minibatches": 2, "unroll_length": 10} if method == "ppo" else {"warmup_steps": 8}
        )
        return small | own
    return {
        "period": 5,
        "periods_per_round": 2,
        "capacity": 400,
        "high_capacity": 400,
        "manager": higl_config.Td3(hidden=(16,), reach=10.0, batch_size=8),
        "controller": higl_config.Td3(hidden=(16,), noise=0.3, batch_size=8),
        "adjacency": higl_config.Adjacency(hidden=(8,), num_features=4, period=40),
        "landmarks": higl_config.Landmarks(
            num_coverage=4, num_novel=4, pool=20, novelty_hidden=(8,), first_step=20, rounds=3
        ),
    }


@pytest.fixture(scope="module")
def maze(tmp_path_factory):
    path = tmp_path_factory.mktemp("mazes") / "corridor.txt"
    path.write_text(MAZE)
    return str(path)


def config_of(method, maze, run, **changes):
    arena = {
        "maze": maze,
        "robot": "point",
        "num_decisions": 2,
        "num_envs": 2,
        "log_rounds": 1,
        "evaluate_every": 2,
        "checkpoint_every": 1,
        "num_eval_episodes": 2,
        "num_steps": 200 if method == "hess" else 80,
        "run": run,
    }
    changes = arena | small_options(method) | changes
    return dataclasses.replace(presets.BASELINES[method], **changes)


@pytest.fixture(scope="module")
def settings(conforming, maze, tmp_path_factory):
    return config_of(conforming, maze, tmp_path_factory.mktemp("runs") / conforming)


@pytest.fixture(scope="module")
def arena(settings):
    """Compiled for one run, it serves others."""
    return baselines.make_arena(settings)


@pytest.fixture(scope="module")
def finished(settings, arena):
    baselines.train_in(arena, settings)
    return settings


def test_metrics_are_numbers_and_episodes_are_counted(finished):
    with (finished.run / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert int(rows[-1]["step"]) >= finished.num_steps
    assert 0.0 <= float(rows[-1]["eval/success"]) <= 1.0
    # An episode is 50 steps long, or shorter where the goal is found by chance.
    ended = sum(float(row["episodes"]) for row in rows)
    assert finished.num_steps // 50 <= ended + finished.num_envs <= finished.num_steps / 10
    assert 0.0 < float(rows[-1]["eval/decisions"]) <= 2.0
    learned = [name for name in rows[-1] if "/" in name and not name.startswith("eval")]
    assert learned and all(math.isfinite(float(rows[-1][name])) for name in learned)


def test_resuming_changes_nothing(finished, arena, tmp_path):
    run = tmp_path / "halves"
    half = finished.num_steps // 2
    baselines.train_in(arena, dataclasses.replace(finished, run=run, num_steps=half))
    baselines.train_in(arena, dataclasses.replace(finished, run=run, resume=True))
    written = (run / "config.json").read_text()
    with pytest.raises(base.UserError, match=r"num_steps = 1 is less than .* has trained: \d+"):
        baselines.train(dataclasses.replace(finished, run=run, resume=True, num_steps=1))
    assert (run / "config.json").read_text() == written
    template = jax.eval_shape(arena.baseline.init, jax.random.key(0))
    states = [checkpoint.restore(path / "checkpoints", template)[1] for path in (finished.run, run)]
    for left, right in zip(*map(jax.tree.leaves, states), strict=True):
        if jax.dtypes.issubdtype(left.dtype, jax.dtypes.prng_key):
            left, right = jax.random.key_data(left), jax.random.key_data(right)
        np.testing.assert_array_equal(left, right)


def test_advancing_keeps_all_types_so_that_it_compiles_once(arena):
    baseline = arena.baseline
    before = jax.eval_shape(baseline.init, jax.random.key(0))
    after, _ = jax.eval_shape(baseline.advance, before)
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (old.shape, old.dtype, old.weak_type) == (new.shape, new.dtype, new.weak_type)


def test_a_baseline_is_evaluated_beside_ours(conforming, finished, maze, tmp_path):
    # One method shows that others stand beside it; each of those others compiles for seconds.
    is_beside = conforming == "droq"
    options = evaluate_config.EvaluateConfig(
        mazes=(maze,),
        robot=("point",),
        movement=("oracle", "full") if is_beside else ("full",),
        high=("uniform", str(finished.run)) if is_beside else (str(finished.run),),
        episodes=3,
        out=tmp_path / "evaluation",
        num_decisions=2,
    )
    cells = evaluations.evaluate(options).cells
    agents = [(cell.agent.movement, cell.agent.high) for cell in cells]
    own = ("full", str(finished.run))
    assert agents.count(own) == 1 and len(agents) == (3 if is_beside else 1)
    cell = cells[agents.index(own)]
    assert cell.agent.low is None and cell.num_episodes == 3
    assert list((tmp_path / "evaluation").glob("*.gif"))


@pytest.mark.slow
@pytest.mark.parametrize("method", ALL_METHODS)
def test_robots_walk_on_either_engine(method, maze, tmp_path):
    options = config_of(method, maze, tmp_path / "run", engine="mjx")
    baselines.train(options)
    with (options.run / "metrics.csv").open() as file:
        *_, last = csv.DictReader(file)
    assert int(last["step"]) >= options.num_steps and 0.0 <= float(last["eval/success"]) <= 1.0
    _, meta = policies.load(policies.find(options.run, "baseline"), kind="baseline")
    assert meta["config"]["engine"] == "mjx"


@pytest.mark.parametrize(("goals", "expected"), [("own", {1.5}), ("anywhere", {1.5, 4.5, 7.5})])
def test_goals_may_lie_anywhere_in_training_but_not_in_evaluations(tmp_path, goals, expected):
    path = tmp_path / "corridor.txt"
    path.write_text("#####\n#1SS#\n#####\n")
    options = {"goals": goals, "num_envs": 40, "robot": "point"}
    arena = baselines.make_arena(config_of("droq", str(path), tmp_path / "run", **options))
    keys = jax.random.split(jax.random.key(0), 40)
    evaluated = jax.jit(jax.vmap(arena.env.reset))(keys)
    trained = jax.jit(arena.baseline.init)(jax.random.key(0)).envs
    for envs, goals_x in ((evaluated, {1.5}), (trained, expected)):
        assert set((envs.obs.goal_xy[:, 0] - 3.0).tolist()) == goals_x


def test_a_baseline_needs_its_robot_and_walking(finished, maze, tmp_path):
    options = evaluate_config.EvaluateConfig(
        mazes=(maze,), high=(str(finished.run),), episodes=1, out=tmp_path / "new"
    )
    with pytest.raises(base.UserError, match="is a policy of robot 'point', expected 'ant'"):
        evaluations.evaluate(options)
    with pytest.raises(base.UserError, match="is a baseline, which walks"):
        evaluations.evaluate(dataclasses.replace(options, movement=("oracle",)))
    with pytest.raises(base.UserError, match="is a baseline, expected a low-level policy"):
        policies.load(policies.find(finished.run, "low"), kind="low")
