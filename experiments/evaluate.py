"""Evaluates a hierarchy in mazes: success with intervals, heatmaps, an animation."""

import rich.console

from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.evaluation import evaluate, tables
from experiments import _cli


def main(options: evaluate_config.EvaluateConfig) -> None:
    """Evaluates, and prints the tables."""
    evaluation = evaluate.evaluate(options)
    tables.show(tables.terminal(evaluation.cells))
    rich.console.Console().print(tables.NOTE, style="dim")
    print(f"written to {options.out}")


if __name__ == "__main__":
    _cli.run(main, evaluate_config.EvaluateConfig)
