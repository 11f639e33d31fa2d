"""Tries out a robot of one's own: `python -m experiments.robot my_robot.xml`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("robot")
