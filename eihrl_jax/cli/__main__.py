"""The commands without an installed `eihrl`: `python -m eihrl_jax.cli train-high`."""

from eihrl_jax.cli import commands

if __name__ == "__main__":
    commands.main()
