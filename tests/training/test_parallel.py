"""Training over devices and over processes: the updates are those of one device."""

import functools
import os
import pathlib
import socket
import subprocess
import sys
import tempfile

import jax
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.training import low_trainer, parallel
from tests.agents import test_peg_a2c
from tests.training import test_parallel_baselines

NUM_UPDATES = 4
ROOT = pathlib.Path(__file__).parents[2]

PROCESS = """
import sys
import jax
import numpy as np
from eihrl_jax.training import parallel
from tests.training import test_parallel

parallel.connect(sys.argv[1], 2, int(sys.argv[2]))
assert jax.device_count() == 2 and jax.local_device_count() == 1
np.savez(sys.argv[3], *getattr(test_parallel, sys.argv[4])(None))
"""


@functools.cache
def train(num_devices):
    """Makes a few updates of a high level, workers spread over so many devices of each process."""
    agent = test_peg_a2c.make(window=2)
    mesh = parallel.make_mesh(num_devices, num_workers=test_peg_a2c.NUM_WORKERS)
    update = parallel.repeated_update(agent, NUM_UPDATES, mesh)
    state, _ = update(parallel.init(agent, 0, mesh))
    return state


def parameters(num_devices):
    """Returns a high level's parameters after a few updates."""
    return jax.tree.leaves(parallel.local(train(num_devices).params))


@functools.cache
def train_low(num_devices):
    """Lets a low level's robots take a few steps, and learns from them."""
    config = low_config.LowConfig(
        robot="point",
        num_envs=8,
        num_iterations=1,
        updates_per_iteration=2,
        capacity=64,
        droq=low_config.Droq(hidden=(16, 16), actor_period=2, batch_size=16),
        log_every=1,
        evaluate_every=1,
        checkpoint_every=1,
        num_devices=num_devices,
    )
    trainer = low_trainer.LowTrainer(config)
    state = trainer.jit_warm_up(trainer.jit_init(jax.random.key(0)), 3)
    # The trainer must outlive what it computes.
    return jax.block_until_ready(trainer.jit_advance(state)[0])


def levels(num_devices):
    """Returns the parameters of both levels after a few updates."""
    low = parallel.local(train_low(num_devices).learner)
    return [*parameters(num_devices), *jax.tree.leaves(low)]


def baseline(num_devices):
    """Returns the parameters of a baseline after a few updates."""
    with tempfile.TemporaryDirectory() as folder:
        state = test_parallel_baselines.train("droq", num_devices, pathlib.Path(folder) / "m.txt")
    return jax.tree.leaves(parallel.local(state.learner))


@pytest.fixture(scope="module")
def alone():
    return train(1)


@pytest.fixture(scope="module")
def low_alone():
    return train_low(1)


def test_eight_devices_train_the_low_level_of_one(low_alone):
    spread = train_low(8)
    for place in (spread.replay.rows.sharding, jax.tree.leaves(spread.envs)[0].sharding):
        assert len(place.device_set) == 8 and not place.is_fully_replicated
    assert_close(jax.tree.leaves(spread.learner), jax.tree.leaves(low_alone.learner))
    assert_close([spread.replay.rows], [low_alone.replay.rows])


def test_eight_devices_make_the_updates_of_one(alone):
    spread = train(8)
    assert len(spread.keys.sharding.device_set) == 8
    np.testing.assert_array_equal(jax.random.key_data(spread.keys), jax.random.key_data(alone.keys))
    np.testing.assert_array_equal(spread.env_state.obs, alone.env_state.obs)
    assert int(spread.num_decisions) == int(alone.num_decisions)
    assert_close(jax.tree.leaves(spread.params), jax.tree.leaves(alone.params))
    for leaf in jax.tree.leaves(spread.params):
        copies = [np.asarray(shard.data) for shard in leaf.addressable_shards]
        for copy in copies[1:]:
            np.testing.assert_array_equal(copy, copies[0])


@pytest.mark.parametrize("kind", [levels, pytest.param(baseline, marks=pytest.mark.slow)])
def test_two_processes_make_the_updates_of_one(kind, tmp_path):
    with socket.socket() as free:
        free.bind(("localhost", 0))
        coordinator = f"localhost:{free.getsockname()[1]}"
    paths = [tmp_path / f"{i}.npz" for i in range(2)]
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "1", "JAX_PLATFORMS": "cpu"}
    environment["PYTHONPATH"] = str(ROOT)
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, coordinator, str(i), str(path), kind.__name__],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i, path in enumerate(paths)
    ]
    for process in processes:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    first, second = (list(np.load(path).values()) for path in paths)
    for left, right in zip(first, second, strict=True):
        np.testing.assert_array_equal(left, right)
    assert_close(first, kind(1))


def assert_close(actual, expected):
    """Compares parameters up to the rounding of a mean taken in another order."""
    for left, right in zip(actual, expected, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-4, atol=1e-6)


def test_as_many_devices_as_can_share_the_workers_evenly():
    assert parallel.make_mesh(None, num_workers=64).size == 8
    assert parallel.make_mesh(None, num_workers=12).size == 6
    assert parallel.make_mesh(None, num_envs=12, batch_size=32).size == 4
    assert parallel.make_mesh(3, num_workers=12).size == 3


@pytest.mark.parametrize(
    ("num_devices", "num_workers", "message"),
    [
        (9, 72, "num_devices = 9 must be at most 8"),
        (8, 12, "num_workers = 12 must be a multiple of the 8 devices"),
    ],
)
def test_devices_that_do_not_fit(num_devices, num_workers, message):
    with pytest.raises(base.UserError, match=message):
        parallel.make_mesh(num_devices, num_workers=num_workers)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((None, 2, 0), "need a coordinator"),
        (("localhost:1", None, 0), "needs num_processes and process_id"),
        (("localhost:1", 2, 2), r"process_id = 2 must be in \[0, 2\)"),
    ],
)
def test_processes_that_do_not_fit(options, message):
    with pytest.raises(base.UserError, match=message):
        parallel.connect(*options)


def test_one_process_needs_no_connection():
    parallel.connect(None)
