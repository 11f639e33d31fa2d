"""Puts everything that the paper reports on one page: `python -m experiments.report`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("report")
