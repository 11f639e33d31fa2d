"""Benchmark of the high level: speed of training, and cost of a decision by the maze's size."""

import dataclasses
import pathlib
import statistics
import tempfile

import jax

from eihrl_jax import base, mazes, robots
from eihrl_jax.benchmarks import part, timing
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import presets
from eihrl_jax.envs import subgoals
from eihrl_jax.evaluation import loading
from eihrl_jax.mazes import parsing, perfect
from eihrl_jax.reporting import evaluations
from eihrl_jax.training import high, parallel


def decisions_per_second(num_updates: int = 50, repeats: int = 5) -> dict[str, part.Figures]:
    """Measures environment and learning together, past compilation.

    Args:
      num_updates: updates per measurement.
      repeats: measurements; the fastest and the median are reported.

    Returns:
      Rates of preset `best`, and of the same learner with the paper's view of 9 units.
    """
    best = presets.high_best()
    # All but task and network as in `best`, so that the views alone differ.
    patch = dataclasses.replace(best, task=high_config.Task(), network=high_config.Network())
    return {
        "planning on a map": _rates(best, num_updates, repeats),
        # Ten times as many, as each takes far less.
        "9-unit view": _rates(patch, 10 * num_updates, repeats),
    }


def decisions_rows(figures: dict[str, part.Figures]) -> part.Rows:
    """Returns the table's rows of the high level's speed of training."""
    return {
        f"decisions per second, environment and learning, {kind}": (
            f"{rates['median']:,.0f} (median), {rates['fastest']:,.0f} (fastest)"
        )
        for kind, rates in figures.items()
    }


def decision_times(
    sides: tuple[int, ...] = (13, 51, 101, 257), num_robots: int = 64, num_decisions: int = 40
) -> dict[str, part.Figures]:
    """Measures searching and moving in perfect mazes of several sizes, past compilation.

    Args:
      sides: cells inside the outer wall.
      num_robots: episodes that run at once.
      num_decisions: of each of them; the median is reported.

    Returns:
      By side, `milliseconds` per decision and robot, and `cells` of the map.
    """
    level = loading.load_high("best-random-0")
    robot = robots.load("ant")
    gait = subgoals.gait(robot, None, base.CELL, base.SIGMA)
    figures = {}
    for side in sides:
        maze = mazes.stack([parsing.parse(perfect.perfect_maze(0, side, side))])
        view = level.view_in(maze)
        env = loading.oracle_env(robot, maze, view, gait=gait, anchored=True).env
        first = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), num_robots))

        def decide(state: base.EnvState, env: base.Environment = env) -> base.EnvState:
            # The most likely directions need no random numbers.
            action = jax.vmap(level.policy, (0, None))(state.obs, jax.random.key(0))
            return jax.vmap(env.step)(state, action)

        advance = jax.jit(decide)
        calls = timing.successive(advance, advance(first), num_decisions)
        seconds = statistics.median(seconds for _, seconds in calls)
        rows, columns, _ = view.obs_shape
        figures[str(side)] = {"milliseconds": 1e3 * seconds / num_robots, "cells": rows * columns}
    return figures


def decision_rows(figures: dict[str, part.Figures]) -> part.Rows:
    """Returns the table's rows of seconds per decision by the maze's size."""
    rows = {}
    for side, each in figures.items():
        per_cell = 1e6 * each["milliseconds"] / each["cells"]
        what = f"milliseconds per decision and robot, perfect maze of {side} cells a side"
        rows[what] = f"{each['milliseconds']:.3f}, {per_cell:.0f} ns a cell"
    return rows


def full_episodes(high_level: str = "best-random-0") -> part.Figures:
    """Measures 500 episodes of the walking ant on the Random Square.

    Args:
      high_level: run folder or shipped name of the high level.

    Returns:
      `seconds`, past compilation, and `success`, the share of goals reached.
    """
    # Without pictures, which would take part of the time.
    with tempfile.TemporaryDirectory() as folder:
        evaluation = evaluations.evaluate(
            evaluate_config.EvaluateConfig(
                mazes=("random",),
                movement=("full",),
                high=(high_level,),
                out=pathlib.Path(folder, "episodes"),
                animate="none",
                heatmaps=False,
            )
        )

    (seconds,) = evaluation.about["seconds"].values()
    return {"seconds": seconds, "success": evaluation.cells[0].success.rate}


def episodes_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of episodes with physics."""
    measured = f"{figures['seconds']:.0f} s, success {100 * figures['success']:.1f} %"
    return {"500 episodes of the walking ant on the Random Square, past compilation": measured}


def _rates(config: high_config.HighConfig, num_updates: int, repeats: int) -> part.Figures:
    """Returns decisions per second, `median` and `fastest` of some measurements."""
    agent = high.make_agent(high.make_env(config.task), config)
    mesh = parallel.make_mesh(None, num_workers=config.learner.num_workers)
    first = parallel.init(agent, config.seed, mesh)
    update = parallel.repeated_update(agent, num_updates, mesh).lower(first).compile()

    # From the state's own count: an update over whole episodes has as many as they took.
    rates, before = [], 0
    for state, seconds in timing.successive(lambda state: update(state)[0], first, repeats + 1):
        num_decisions = int(state.num_decisions)
        rates.append((num_decisions - before) / seconds)
        before = num_decisions
    # The first call warms up.
    return {"median": statistics.median(rates[1:]), "fastest": max(rates[1:])}
