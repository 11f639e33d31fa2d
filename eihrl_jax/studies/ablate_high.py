"""Measures what epsilon, postures and workers give: `python -m experiments.ablate_high`."""

import functools
import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import changes, checks, limits, presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.drawing import curves, figures
from eihrl_jax.evaluation import paper, tables
from eihrl_jax.mazes import suites
from eihrl_jax.reporting import cached_runs, comparison
from eihrl_jax.storage import writing
from eihrl_jax.studies import ablation
from eihrl_jax.training import high

VARIANTS: dict[str, dict[str, object]] = {
    "preset": {},
    "epsilon 0": {"task.sigma": 0.0},
    "epsilon 0.15": {"task.sigma": 0.15},
    "epsilon 0.6": {"task.sigma": 0.6},
    "one posture": {"task.num_postures": 1},
    "1 worker": {"learner.num_workers": 1},
    "4 workers": {"learner.num_workers": 4},
    "16 workers": {"learner.num_workers": 16},
    "256 workers": {"learner.num_workers": 256},
}
"""What is changed, one thing at a time, by name; the presets have an epsilon of 0.3 units."""

SEARCH_VARIANTS: dict[str, dict[str, object]] = {
    "preset": {},
    "epsilon 0": {"task.sigma": 0.0},
    "not anchored": {"task.anchored": False},
    "sampled": {"greedy": False},
    "no look-ahead": {"network.look_ahead": 0},
    "look-ahead 8": {"network.look_ahead": 8},
    "cells alone": {"network.around": "nothing"},
    "corners too": {"network.around": "corners"},
    "entropy 0.02": {"learner.entropy": 0.02},
    "view of 9 units": {"task.extent": 9.0, "task.pixels": 15},
}
"""The same for presets that search a map, which see no postures."""


def variants(preset: str) -> dict[str, dict[str, object]]:
    """Returns what is changed of a preset."""
    return SEARCH_VARIANTS if _searches(preset) else VARIANTS


@limits.dataclass
class AblationConfig:
    """Trains a preset of the high level with one thing changed at a time, and compares.

    Every variant is trained on the Random Square for the same number of updates, then evaluated
    unchanged in other mazes, beside a high level that learns nothing: uniform directions (RAND-H),
    or the classical search for presets that search. Runs and evaluations that the folder already
    holds are continued or taken as they are. Writes table.md and curves.png from all variants that
    are there.

    Attributes:
      preset: of `train_high`; `paper` has 64 workers and sees postures, `best` searches a map.
      variants: what to train; default: everything, which depends on the preset.
      seeds: of the training runs of each variant.
      num_updates: of each run, a multiple of the preset's `log_every`; None: the preset's.
      robot: that walks.
      mazes: to evaluate in; default: those of Table 1, for presets that search the suite in which
        choices are made, `development`.
      movement: of the evaluation; oracle moves with an epsilon of 0.3 units whatever it was trained
        with.
      episodes: per maze.
      out: folder of the runs and the results.
    """

    preset: Annotated[str, limits.OneOf(presets.HIGH)] = "paper"
    variants: tuple[str, ...] = ()
    seeds: limits.Seeds = (0, 1, 2)
    num_updates: int | None = None
    robot: str = "ant"
    mazes: tuple[str, ...] = ()
    movement: limits.Several[base.MovementName] = base.MOVEMENTS
    episodes: limits.UpToMillion = 500
    out: pathlib.Path = pathlib.Path("runs/ablation-high")

    def __post_init__(self) -> None:
        """Checks what depends on the preset."""
        if self.variants:
            checks.each_of("variants", self.variants, tuple(variants(self.preset)))
        if self.num_updates is not None:
            every = presets.HIGH[self.preset].log_every
            checks.divides("log_every", every, "num_updates", self.num_updates)


def main(config: AblationConfig) -> None:
    """Trains and evaluates what is missing, then compares what is there."""
    runs = _runs(config)
    chosen = config.variants or tuple(runs.variants)

    # Seed by seed and variant by variant, so that an early stop leaves something to compare.
    runs.train(chosen, high.train)
    cached_runs.share(
        functools.partial(cached_runs.evaluated, _evaluation(config, runs, variant))
        for variant in (*chosen, _reference(config.preset))
    )

    table = compare(config)
    writing.write_text(config.out / "table.md", table)
    print(table)


def compare(config: AblationConfig) -> str:
    """Draws the learning curves of finished runs, and returns the table of what was evaluated."""
    runs = _runs(config)
    drawn = {
        variant: [curves.read(file, "step", "eval/success") for file in files]
        for variant, files in runs.finished().items()
    }
    path = config.out / "curves.png"
    y_label = "success while training, %"

    def draw() -> None:
        curves.save_spread(path, drawn, x_label="updates", y_label=y_label, y_scale=100.0)

    figures.attempt(path, draw)

    # Also variants of earlier calls: the folder is the comparison.
    evaluations = {
        variant: _evaluation(config, runs, variant)
        for variant in (*runs.variants, _reference(config.preset))
    }
    evaluated = {
        variant: cached_runs.evaluated(options)
        for variant, options in evaluations.items()
        if options.out.exists()
    }
    title = f"Preset {config.preset}, one thing changed at a time"
    return comparison.of_variants(title, evaluated).markdown() + "\n"


def _searches(preset: str) -> bool:
    """Returns whether a preset's network searches a map."""
    return presets.HIGH[preset].network.kind == "search"


def _reference(preset: str) -> str:
    """Returns what a preset is compared with that learns nothing."""
    return evaluate_config.FRONTIER if _searches(preset) else paper.RAND_H


def _runs(config: AblationConfig) -> ablation.Ablation[high_config.HighConfig]:
    """Returns all runs that may be compared."""
    preset = presets.HIGH[config.preset]
    if config.num_updates is not None:
        preset = changes.apply(preset, {"learner.num_updates": config.num_updates})
    return ablation.Ablation(
        preset=preset, variants=variants(config.preset), seeds=config.seeds, out=config.out
    )


def _evaluation(
    config: AblationConfig, runs: ablation.Ablation[high_config.HighConfig], variant: str
) -> evaluate_config.EvaluateConfig:
    """Returns the options with which what was trained alike is evaluated."""
    if variant == paper.RAND_H:
        highs = (evaluate_config.UNIFORM,)
    elif variant == evaluate_config.FRONTIER:
        highs = (variant,)
    else:
        highs = tuple(str(options.run) for options in runs.runs(variant))

    ours = (suites.DEVELOPMENT,) if _searches(config.preset) else tuple(tables.TABLE1_MAZES)
    return evaluate_config.EvaluateConfig(
        mazes=config.mazes or ours,
        robot=(config.robot,),
        movement=config.movement,
        high=highs,
        episodes=config.episodes,
        out=config.out / "evaluations" / ablation.folder(variant),
        animate="none",
        heatmaps=False,
    )
