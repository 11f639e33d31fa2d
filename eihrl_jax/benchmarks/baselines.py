"""Measurements of the baselines for `experiments.benchmark`: HIGL's speed."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from eihrl_jax.baselines.higl import adjacency
from eihrl_jax.config import higl as config_lib
from eihrl_jax.config import presets
from eihrl_jax.training import baselines

PUBLISHED = 1e6 / (13 * 3600)
"""HIGL's control steps per second, learning included: a million in 13 hours (released code)."""


def higl_rate(maze: str = "random", rounds: int = 4, repeats: int = 5) -> dict[str, float]:
    """Measures HIGL with its own settings, landmarks and learning included, past compilation.

    Fits of the adjacency network, which are due once in `adjacency.period` steps, are measured
    alone, as long as they can get, and their share is taken off.

    Args:
      maze: name of the maze.
      rounds: of walking and learning per measurement.
      repeats: measurements, of which the median counts.

    Returns:
      Control steps per second, and how many times the published ones they are.
    """
    config = presets.higl()
    landmarks = dataclasses.replace(config.landmarks, first_step=0)
    # No fit falls due while rounds are measured.
    places = dataclasses.replace(config.adjacency, period=2**31 - 1)
    timed = dataclasses.replace(config, maze=maze, landmarks=landmarks, adjacency=places)
    arena = baselines.make_arena(timed)
    baseline = arena.baseline
    state = jax.jit(baseline.init)(jax.random.key(0))

    def walk(state: Any) -> Any:
        return jax.lax.scan(lambda state, _: baseline.advance(state), state, length=rounds)[0]

    seconds = _median_seconds(walk, state, repeats) / (rounds * baseline.steps_per_round)
    seconds += _fit_seconds(arena.side_xy, config.adjacency) / config.adjacency.period
    return {"rate": 1.0 / seconds, "ratio": 1.0 / seconds / PUBLISHED}


def _fit_seconds(side_xy: tuple[int, int], options: config_lib.Adjacency) -> float:
    """Measures a fit of the adjacency network after every square was visited."""
    network = adjacency.AdjacencyNetwork(side_xy[1], side_xy[0], options)
    key = jax.random.key(0)
    state = network.init(key)
    everywhere = state.replace(table=jnp.ones_like(state.table))
    return _median_seconds(lambda state: network.fit(state, key)[0], everywhere, 1)


def _median_seconds(function: Callable[[Any], Any], state: Any, repeats: int) -> float:
    """Returns what a call takes, past compilation, each going on from the last."""
    compiled = jax.jit(function).lower(state).compile()
    state = jax.block_until_ready(compiled(state))
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        state = jax.block_until_ready(compiled(state))
        seconds.append(time.perf_counter() - begin)
    return sorted(seconds)[repeats // 2]
