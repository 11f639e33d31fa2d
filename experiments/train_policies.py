"""Trains every shipped high level again: `python -m experiments.train_policies`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("train_policies")
