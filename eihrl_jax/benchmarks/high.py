"""Measurements of the high level for `experiments.benchmark`: its speed."""

import dataclasses
import pathlib
import time

import jax

from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.config import presets
from eihrl_jax.reporting import evaluations
from eihrl_jax.training import high, parallel


def decisions_per_second(num_updates: int = 50, repeats: int = 5) -> dict[str, dict[str, float]]:
    """Measures environment and learning together, past compilation.

    Args:
      num_updates: updates per measurement.
      repeats: measurements; the fastest and the median are reported.

    Returns:
      Rates of preset `best`, and of the same learner with the paper's view of 9 units.
    """
    best = presets.high_best()
    patch = dataclasses.replace(best, task=high_config.Task(), network=high_config.Network())
    return {
        "planning on a map": _rates(best, num_updates, repeats),
        "9-unit view": _rates(patch, 10 * num_updates, repeats),
    }


def _rates(config: high_config.HighConfig, num_updates: int, repeats: int) -> dict[str, float]:
    agent = high.make_agent(high.make_env(config.task), config)
    mesh = parallel.make_mesh(None, config.learner.num_workers)
    state = parallel.init(agent, config.seed, mesh)
    update = parallel.repeated_update(agent, num_updates, mesh).lower(state).compile()
    rates = []
    for _ in range(repeats + 1):  # the first one warms up
        before, begin = int(state.num_decisions), time.perf_counter()
        state, _ = jax.block_until_ready(update(state))
        rates.append((int(state.num_decisions) - before) / (time.perf_counter() - begin))
    ordered = sorted(rates[1:])
    return {"median": ordered[repeats // 2], "fastest": ordered[-1]}


def full_episodes_seconds(folder: pathlib.Path, high_level: str) -> dict[str, float]:
    """Measures 500 episodes of the walking ant on the Random Square, past compilation.

    Args:
      folder: new folder for the evaluation.
      high_level: run folder or shipped name of the high level.
    """
    found = evaluations.evaluate(
        evaluate_config.EvaluateConfig(
            mazes=("random",), movement=("full",), high=(high_level,), out=folder, animate="none"
        )
    )
    (seconds,) = found.about["seconds"].values()
    return {"seconds": seconds, "success": found.cells[0].success.rate}
