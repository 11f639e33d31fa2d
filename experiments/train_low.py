"""Trains a low level: `python -m experiments.train_low --robot ant --run runs/ant`."""

from eihrl_jax import presets
from eihrl_jax.config import low as low_config
from eihrl_jax.training import low
from experiments import _cli


def main() -> None:
    """Parses the options and trains."""
    _cli.run(low.train, low_config.LowConfig, presets.LOW)


if __name__ == "__main__":
    main()
