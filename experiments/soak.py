"""Trains, evaluates and steps environments for long: `python -m experiments.soak`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("soak")
