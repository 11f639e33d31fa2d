"""Repeats DroQ's published experiment: `python -m experiments.reproduce_droq --run runs/droq`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("reproduce_droq")
