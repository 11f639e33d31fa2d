"""Trains a high level: `python -m experiments.train_high --preset best --run runs/high`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("train_high")
