"""What holds for every test: CPU with eight virtual devices, and JAX at its strictest.

Shapes are checked by beartype (see `addopts` in pyproject.toml) and warnings are errors. A program
that several tests compile is compiled once.

What is trained here differs by processor, for rounding does: `XLA_FLAGS=--xla_cpu_max_isa=SSE4_2`
before `make test` shows whether a test hangs on that.
"""

import os
import tempfile

import jax

# A test marked `gpu` needs JAX_PLATFORMS=cuda from outside.
jax.config.update("jax_platforms", os.environ.get("JAX_PLATFORMS", "cpu"))
jax.config.update("jax_num_cpu_devices", 8)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

_PROGRAMS = tempfile.TemporaryDirectory(prefix="eihrl_jax-tests-")  # removed when Python ends
jax.config.update("jax_compilation_cache_dir", _PROGRAMS.name)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
