"""One robot in several mazes, animated side by side: `python -m experiments.gallery`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("gallery")
