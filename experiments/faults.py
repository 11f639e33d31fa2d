"""Disturbs runs in all ways and goes on with them: `python -m experiments.faults`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("faults")
