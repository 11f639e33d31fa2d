"""Measures a low level: `python -m experiments.measure_low --robot ant --low runs/ant`."""

from eihrl_jax.config import measure as measure_config
from eihrl_jax.evaluation import measure, tables
from experiments import _cli


def main(options: measure_config.MeasureConfig) -> None:
    """Measures, and prints the table."""
    found = measure.measure(options)
    tables.show([tables.of_subgoals(found, options.robot)])
    print(f"written to {options.out}")


if __name__ == "__main__":
    _cli.run(main, measure_config.MeasureConfig)
