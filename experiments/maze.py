"""Shows a maze as text and picture: `python -m experiments.maze FILE --picture maze.png`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("maze")
