"""Lists what is shipped: `python -m experiments.list --what robots`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.run("list")
