"""Repeats HIGL's published experiment: `python -m experiments.reproduce_higl --run runs/higl-u`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("reproduce_higl")
