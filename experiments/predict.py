"""Predicts success from a robot's end points, without physics: `python -m experiments.predict`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("predict")
