"""Measures a low level: `python -m experiments.measure_low --robot ant --low runs/ant`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("measure_low")
