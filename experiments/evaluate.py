"""Evaluates policies in mazes: `python -m experiments.evaluate --mazes u --out runs/u`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("evaluate")
