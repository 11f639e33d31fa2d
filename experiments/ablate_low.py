"""Measures what each option of the low level gains: `python -m experiments.ablate_low`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("ablate_low")
