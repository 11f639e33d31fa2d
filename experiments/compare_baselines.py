"""Trains ours and the baselines at equal budgets: `python -m experiments.compare_baselines`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("compare_baselines")
