"""Draws learning curves of runs: `python -m experiments.plot runs/high runs/other`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("plot")
