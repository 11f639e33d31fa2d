"""Kills a trainer at random moments and goes on with it: `python -m experiments.kill_resume`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("kill_resume")
