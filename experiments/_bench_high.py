"""Measurements of the high level for `experiments.benchmark`: speed, and what a minute teaches."""

import dataclasses
import pathlib
import statistics
import time
from typing import Any

import jax

from eihrl_jax import presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.evaluation import evaluate, results
from eihrl_jax.mazes import generators
from eihrl_jax.training import high, parallel

MAZES = ("random", "g1", "g2", "g3")

WIDE_VIEW = {"extent": 15.0, "pixels": 25}
"""A larger view: five cells instead of three, with pixels of the same size."""

WIDE_UPDATES = 800
"""Updates with the larger view, whose decisions cost more, in about a minute on two cores."""


PHANTOM_WALLS = (0.0, 0.3, 0.6)
"""Probabilities among which preset `best` was to choose."""

NUM_ROOMS = 64
"""Generated rooms on which they are compared."""


def decisions_per_second(num_updates: int = 500, repeats: int = 5) -> dict[str, float]:
    """Measures environment and learning together, preset `best`, past compilation.

    Args:
      num_updates: updates per measurement.
      repeats: measurements; the fastest and the median are reported.
    """
    config = presets.high_best()
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


def train_and_test(folder: pathlib.Path, num_seeds: int, *, is_wide: bool) -> list[dict[str, Any]]:
    """Trains preset `best` on the Random Square, then tests it unchanged by Table 1's protocol.

    Args:
      folder: new folder for the runs.
      num_seeds: training runs, with seeds 0, 1, ...
      is_wide: whether the view is 15 instead of 9 units wide.

    Returns:
      Per seed: `seconds` of training past compilation, and `success` by maze, 500 episodes each,
      directions sampled, oracle movement; `generated rooms` is the mean over 64 of them, 50
      episodes each, by which one of several runs may be chosen.
    """
    return [_train_and_test(folder / f"seed-{seed}", seed, is_wide) for seed in range(num_seeds)]


def _train_and_test(folder: pathlib.Path, seed: int, is_wide: bool) -> dict[str, Any]:
    config = dataclasses.replace(presets.high_best(), run=folder / "high", seed=seed)
    if is_wide:
        config = _widen(config)
    seconds = high.train(config)
    cells = _test(folder, MAZES, seed, episodes=500)
    success = {cell.maze: cell.success.rate for cell in cells}
    success["generated rooms"] = _test_in_rooms(folder, seed)
    return {"seed": seed, "seconds": seconds, "success": success}


def choose_phantom_walls(folder: pathlib.Path, num_seeds: int) -> list[dict[str, Any]]:
    """Compares probabilities of phantom walls on generated rooms, which no test maze is among.

    Args:
      folder: new folder for the runs.
      num_seeds: training runs of each, with seeds 100, 101, ..., which no other part uses.

    Returns:
      Per probability: the mean `success` over 64 rooms in each run, 50 episodes a room, directions
      sampled, oracle movement, four times the shortest path of time.
    """
    found = []
    for probability in PHANTOM_WALLS:
        success = []
        for seed in range(100, 100 + num_seeds):
            run = folder / f"{probability:.1f}" / f"seed-{seed}"
            best = presets.high_best()
            task = dataclasses.replace(best.task, phantom_walls=probability)
            config = dataclasses.replace(best, run=run / "high", seed=seed, task=task)
            high.train(config)
            success.append(_test_in_rooms(run, seed))
        found.append({"probability": probability, "success": success})
    return found


def _test_in_rooms(run: pathlib.Path, seed: int) -> float:
    """Returns the mean success of the high level `run / "high"` in generated rooms."""
    files = [run / "rooms" / f"room-{index:02d}.txt" for index in range(NUM_ROOMS)]
    files[0].parent.mkdir(parents=True, exist_ok=True)
    for index, file in enumerate(files):
        file.write_text(generators.random_room(index, 7, 7))
    names = tuple(map(str, files))
    cells = _test(run, names, seed, episodes=50, out="evaluation-rooms")
    return statistics.mean(cell.success.rate for cell in cells)


def _test(
    run: pathlib.Path,
    mazes: tuple[str, ...],
    seed: int,
    episodes: int,
    out: str = "evaluation",
) -> tuple[results.Cell, ...]:
    """Runs the high level `run / "high"` unchanged in mazes, oracle movement."""
    return evaluate.evaluate(
        evaluate_config.EvaluateConfig(
            mazes=mazes,
            movement=("oracle",),
            high=(str(run / "high"),),
            episodes=episodes,
            seeds=(1000 + seed,),
            out=run / out,
            animate="none",
        )
    ).cells


def _widen(config: high_config.HighConfig) -> high_config.HighConfig:
    return dataclasses.replace(
        config,
        task=dataclasses.replace(config.task, **WIDE_VIEW),
        learner=dataclasses.replace(config.learner, num_updates=WIDE_UPDATES),
    )


def full_episodes_seconds(folder: pathlib.Path, high_level: str) -> dict[str, float]:
    """Measures 500 episodes of the walking ant on the Random Square, past compilation.

    Args:
      folder: new folder for the evaluation.
      high_level: run folder or shipped name of the high level.
    """
    found = evaluate.evaluate(
        evaluate_config.EvaluateConfig(
            mazes=("random",), movement=("full",), high=(high_level,), out=folder, animate="none"
        )
    )
    (seconds,) = found.about["seconds"].values()
    return {"seconds": seconds, "success": found.cells[0].success.rate}
