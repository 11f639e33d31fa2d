"""The earlier name of `experiments.compare_baselines`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("compare_baselines")
