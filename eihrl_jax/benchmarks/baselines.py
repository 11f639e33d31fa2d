"""Benchmark of the baselines: HIGL's speed."""

import dataclasses
import statistics
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from eihrl_jax.baselines import interface
from eihrl_jax.baselines.higl import adjacency
from eihrl_jax.benchmarks import part, timing
from eihrl_jax.config import higl as config_lib
from eihrl_jax.config import presets
from eihrl_jax.training import baselines

PUBLISHED = 1e6 / (13 * 3600)
"""HIGL's control steps per second, learning included: a million in 13 hours (released code)."""

StateT = TypeVar("StateT")


def higl_rate(maze: str = "random", rounds: int = 4, repeats: int = 5) -> part.Figures:
    """Measures HIGL with its own settings, landmarks and learning included, past compilation.

    Fits of the adjacency network, which are due once in `adjacency.period` steps, are measured
    alone, as long as they can get, and their share is taken off.

    Args:
      maze: name of the maze.
      rounds: of walking and learning per measurement.
      repeats: measurements, of which the median counts.

    Returns:
      `rate`, control steps per second, and `ratio`, how many times the published ones they are.
    """
    preset = presets.higl()
    # Landmarks from the first step, as nearly all of a run of a million has them.
    config = dataclasses.replace(
        preset,
        maze=maze,
        landmarks=dataclasses.replace(preset.landmarks, first_step=0),
        # No fit falls due while rounds are measured.
        adjacency=dataclasses.replace(preset.adjacency, period=2**31 - 1),
    )

    arena = baselines.make_arena(config)
    higl = arena.baseline
    assert isinstance(higl, interface.Baseline)

    def advance(state: StateT) -> StateT:
        return jax.lax.scan(lambda state, _: higl.advance(state), state, length=rounds)[0]

    state = jax.jit(higl.init)(jax.random.key(0))
    seconds = _median_seconds(advance, state, repeats) / (rounds * higl.steps_per_round)
    # Fits are due once in `period` steps; each step bears its share.
    seconds += _fit_seconds(arena.side_xy, preset.adjacency) / preset.adjacency.period
    return {"rate": 1.0 / seconds, "ratio": 1.0 / seconds / PUBLISHED}


def higl_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of HIGL's speed."""
    rate, ratio = figures["rate"], figures["ratio"]
    measured = f"{rate:.0f} control steps/s, {ratio:.1f} times the published"
    return {"HIGL with its own settings, learning included": measured}


def _fit_seconds(side_xy: tuple[int, int], options: config_lib.Adjacency) -> float:
    """Measures a fit of the adjacency network after every square was visited."""
    network = adjacency.AdjacencyNetwork(side_xy[1], side_xy[0], options)
    key = jax.random.key(0)
    state = network.init(key)
    everywhere = state.replace(table=jnp.ones_like(state.table))
    return _median_seconds(lambda state: network.fit(state, key)[0], everywhere, 1)


def _median_seconds(function: Callable[[StateT], StateT], state: StateT, repeats: int) -> float:
    """Returns a call's median seconds, compilation excluded; each call continues from the last."""
    compiled = jax.jit(function).lower(state).compile()
    seconds = [seconds for _, seconds in timing.successive(compiled, state, repeats + 1)]
    return statistics.median(seconds[1:])  # the first call warms up
