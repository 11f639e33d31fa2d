"""Compares bounds on the hierarchy's loss with the loss: `python -m experiments.value_gap`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("value_gap")
