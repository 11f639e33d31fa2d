"""Trains a high level: `python -m experiments.train_high --preset best --run runs/high`."""

from eihrl_jax import presets
from eihrl_jax.config import high as high_config
from eihrl_jax.training import high, parallel
from experiments import _cli


def main(config: high_config.HighConfig) -> None:
    """Trains on every core."""
    parallel.use_cpu_cores()
    high.train(config)


if __name__ == "__main__":
    _cli.run(main, high_config.HighConfig, presets.HIGH)
