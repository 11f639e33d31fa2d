"""Writes episodes as a dataset of Minari: `python -m experiments.dataset --maze u --robot ant`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("dataset")
