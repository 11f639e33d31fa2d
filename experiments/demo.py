"""The main job in one command: `python -m experiments.demo`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("demo")
