"""Compares bounds on the hierarchy's loss with the loss measured: `experiments.value_gap`."""

from eihrl_jax.config import value_gap as gap_config
from eihrl_jax.evaluation import value_gap
from experiments import _cli


def main(options: gap_config.ValueGapConfig) -> None:
    """Measures, and prints the table."""
    gaps = value_gap.compare(options)
    print(value_gap.markdown(gaps), end="")
    print(f"written to {options.out}")


if __name__ == "__main__":
    _cli.run(main, gap_config.ValueGapConfig)
