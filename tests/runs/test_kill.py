"""A process killed with SIGKILL while it saves leaves a complete checkpoint behind."""

import pathlib
import random
import subprocess
import sys
import time

import jax.numpy as jnp
import numpy as np

from eihrl_jax.runs import checkpoint

SAVE_FOREVER = """
import itertools, pathlib, sys
import jax.numpy as jnp
from eihrl_jax.runs import checkpoint
folder, shape = pathlib.Path(sys.argv[1]), (int(sys.argv[2]),)
for step in itertools.count(int(sys.argv[3])):
    checkpoint.save(folder, step, {"x": jnp.full(shape, float(step))})
    print(step, flush=True)
"""
SIZE = 500_000


def save_until_killed(folder: pathlib.Path, first_step: int, seconds: float) -> int:
    """Saves again and again, kills some time after the first save; returns the last step told."""
    process = subprocess.Popen(
        [sys.executable, "-c", SAVE_FOREVER, str(folder), str(SIZE), str(first_step)],
        cwd=pathlib.Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    told = [process.stdout.readline()]
    time.sleep(seconds)
    process.kill()
    told += process.stdout.read().split("\n")
    process.wait()
    process.stdout.close()
    return max(int(line) for line in told if line.strip())


def test_last_checkpoint_survives_kills(tmp_path):
    template = {"x": jnp.zeros(SIZE)}
    moments = random.Random(0)
    step = 0
    for _ in range(3):
        told = save_until_killed(tmp_path, step + 1, moments.uniform(0.05, 0.5))
        step, state = checkpoint.restore(tmp_path, template)
        assert step in (told, told + 1)
        np.testing.assert_array_equal(state["x"], float(step))
    checkpoint.save(tmp_path, step + 1, template)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"{step:012d}", f"{step + 1:012d}"]
