"""Trains the two-level baselines in a small point maze: `python -m experiments.small_maze`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("small_maze")
