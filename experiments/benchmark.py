"""Measures docs/benchmarks.md: `python -m experiments.benchmark --out runs/benchmark`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("benchmark")
