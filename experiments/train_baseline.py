"""Trains a baseline: `python -m experiments.train_baseline --method higl --run runs/higl`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("train_baseline")
