"""Workers over devices and over processes: the updates are those of one device."""

import os
import pathlib
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.training import parallel
from tests.agents import test_peg_a2c

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
state = test_parallel.train(None)
leaves = jax.tree.leaves(state.params)
np.savez(sys.argv[3], *(leaf.addressable_data(0) for leaf in leaves))
"""


def train(num_devices):
    """Makes a few updates with the workers spread over so many devices of each process."""
    agent = test_peg_a2c.make(window=2)
    mesh = parallel.make_mesh(num_devices, test_peg_a2c.NUM_WORKERS)
    update = parallel.repeated_update(agent, NUM_UPDATES, mesh)
    state, _ = update(parallel.init(agent, 0, mesh))
    return state


@pytest.fixture(scope="module")
def alone():
    return train(1)


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


def test_two_processes_make_the_updates_of_one(alone, tmp_path):
    with socket.socket() as free:
        free.bind(("localhost", 0))
        coordinator = f"localhost:{free.getsockname()[1]}"
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "1", "JAX_PLATFORMS": "cpu"}
    environment["PYTHONPATH"] = str(ROOT)
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS, coordinator, str(i), str(tmp_path / f"{i}.npz")],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i in range(2)
    ]
    for process in processes:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    first, second = (list(np.load(tmp_path / f"{i}.npz").values()) for i in range(2))
    for left, right in zip(first, second, strict=True):
        np.testing.assert_array_equal(left, right)
    assert_close(first, jax.tree.leaves(alone.params))


def assert_close(actual, expected):
    """Compares parameters up to the rounding of a mean taken in another order."""
    for left, right in zip(actual, expected, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-4, atol=1e-6)


def test_as_many_devices_as_can_share_the_workers_evenly():
    assert parallel.make_mesh(None, 64).size == 8
    assert parallel.make_mesh(None, 12).size == 6
    assert parallel.make_mesh(3, 12).size == 3


@pytest.mark.parametrize(
    ("num_devices", "num_workers", "message"),
    [
        (9, 72, "num_devices = 9 must be at most 8"),
        (8, 12, "num_workers = 12 must be a multiple of the 8 devices"),
    ],
)
def test_devices_that_do_not_fit(num_devices, num_workers, message):
    with pytest.raises(base.UserError, match=message):
        parallel.make_mesh(num_devices, num_workers)


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
