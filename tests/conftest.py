"""What holds for every test: CPU with eight virtual devices, and JAX at its strictest.

Shapes are checked by beartype (see `addopts` in pyproject.toml) and warnings are errors.

Nearly all of a test's time is compilation. So programs are hardly optimised, which halves it, and
one that several tests compile is compiled once. Who sets one of these variables decides it:
`JAX_DISABLE_MOST_OPTIMIZATIONS=0 XLA_FLAGS= make test` runs what users run.

What is trained here differs by processor, for rounding does: `XLA_FLAGS=--xla_cpu_max_isa=SSE4_2`
before `make test` shows whether a test hangs on that.
"""

import os
import signal
import tempfile

# The commands that tests start inherit both.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)

import jax
import pytest

# A test marked `gpu` needs JAX_PLATFORMS=cuda from outside.
jax.config.update("jax_platforms", os.environ.get("JAX_PLATFORMS", "cpu"))
jax.config.update("jax_num_cpu_devices", 8)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

_PROGRAMS = tempfile.TemporaryDirectory(prefix="eihrl_jax-tests-")  # removed when Python ends
jax.config.update("jax_compilation_cache_dir", _PROGRAMS.name)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)

# A shell has its jobs in the background ignore Ctrl-C, which some tests press.
signal.signal(signal.SIGINT, signal.default_int_handler)

LONGEST_FILES = (
    "baselines/test_two_levels.py",
    "training/test_low.py",
    "baselines/test_conformance.py",
    "baselines/test_conformance_higl.py",
    "agents/test_droq.py",
    "reporting/test_evaluations.py",
    "baselines/test_probes.py",
    "baselines/test_hess_parts.py",
    "baselines/test_higl_parts.py",
    "notebooks/test_environments.py",
    "baselines/test_conformance_hess.py",
)
"""Begun first, so that none of them runs alone at the end; see `--durations`."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the longest files first."""
    rank = {f"tests/{name}": i for i, name in enumerate(LONGEST_FILES)}
    items.sort(key=lambda item: rank.get(item.location[0], len(rank)))


@pytest.fixture
def optimised():
    """Lets a test that computes for longer than it compiles have its programs optimised."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", before)
