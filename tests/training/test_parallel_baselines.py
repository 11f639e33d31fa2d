"""Baselines trained over devices: what they learn is what one device learns, to rounding."""

import dataclasses

import jax
import numpy as np
import pytest

from eihrl_jax.baselines import interface
from eihrl_jax.config import baselines as config_lib
from eihrl_jax.config import hess, higl, presets
from eihrl_jax.config import low as low_config
from eihrl_jax.training import baselines

MAZE = """\
####
#1S#
####
"""

LEVEL = {"hidden": (8,), "batch_size": 16}
OPTIONS = {
    "droq": {
        "warmup_steps": 8,
        "iterations_per_round": 2,
        "updates_per_step": 1,
        "capacity": 64,
        "learner": low_config.Droq(hidden=(8, 8), actor_period=2, batch_size=16),
    },
    "higl": {
        "period": 5,
        "periods_per_round": 2,
        "updates_per_step": 0.1,
        "capacity": 160,
        "high_capacity": 32,
        "manager": higl.Td3(**LEVEL),
        "controller": higl.Td3(**LEVEL),
        "adjacency": higl.Adjacency(steps=2, hidden=(8,), period=80, batch_size=8, max_updates=2),
        "landmarks": higl.Landmarks(num_coverage=4, num_novel=2, pool=10, first_step=1),
    },
    "hess": {
        "capacity": 16,
        "high_capacity": 32,
        "period": 25,
        "manager": hess.Sac(**LEVEL),
        "controller": hess.Ddpg(critic_hidden=(8,), updates_per_step=0.01, **LEVEL),
        "representation": hess.Representation(hidden=(8,), batch_size=8, num_updates=2, every=200),
        "exploration": hess.Exploration(first_step=1, every=1, num_candidates=4),
    },
}
"""Of each learner of ours, whatever its guidance: a round is a few steps and updates."""


def train(method, num_devices, path):
    """Returns the state after two rounds."""
    path.write_text(MAZE)
    config = dataclasses.replace(
        presets.BASELINES[method],
        maze=str(path),
        num_decisions=2,
        robot="point",
        num_envs=8,
        num_devices=num_devices,
        **OPTIONS[method],
    )
    assert isinstance(config, config_lib.BaselineConfig)
    arena = baselines.make_arena(config)
    assert isinstance(arena.baseline, interface.Baseline)
    # The arena must outlive what it computes.
    return jax.block_until_ready(arena.advance(arena.init(jax.random.key(0)), 2)[0])


SLOW = [pytest.param(method, marks=pytest.mark.slow) for method in ("higl", "hess")]


@pytest.mark.parametrize("method", ["droq", *SLOW])
def test_eight_devices_train_a_baseline_as_one(method, tmp_path):
    alone = train(method, 1, tmp_path / "maze.txt")
    spread = train(method, 8, tmp_path / "maze.txt")
    stores = spread.replay if method == "droq" else spread.high_replay
    for place in (jax.tree.leaves(spread.envs)[0].sharding, stores.rows.sharding):
        assert len(place.device_set) == 8 and not place.is_fully_replicated
    for left, right in zip(jax.tree.leaves(spread), jax.tree.leaves(alone), strict=True):
        if jax.dtypes.issubdtype(left.dtype, jax.dtypes.prng_key):
            left, right = jax.random.key_data(left), jax.random.key_data(right)
        # The second round acts with parameters that differ by rounding, which contacts amplify.
        np.testing.assert_allclose(left, right, rtol=2e-3, atol=2e-3)
