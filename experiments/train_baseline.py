"""Trains a baseline: `python -m experiments.train_baseline --method higl --run runs/higl`."""

from eihrl_jax import presets
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.training import baselines
from experiments import _cli


def main() -> None:
    """Parses the options and trains."""
    _cli.run(baselines.train, baselines_config.BaselineConfig, presets.BASELINES, option="method")


if __name__ == "__main__":
    main()
