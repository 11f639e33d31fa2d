"""Measures what epsilon, postures and workers give: `python -m experiments.ablate_high`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("ablate_high")
