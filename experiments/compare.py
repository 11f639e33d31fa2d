"""Compares runs: `python -m experiments.compare runs/high runs/other`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("compare")
