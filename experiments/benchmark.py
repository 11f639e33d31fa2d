"""Measures what the README claims: `python -m experiments.benchmark --out runs/benchmark`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("benchmark")
