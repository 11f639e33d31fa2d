"""Trains a low level: `python -m experiments.train_low --robot ant --run runs/ant`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("train_low")
