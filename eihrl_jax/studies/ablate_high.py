"""Measures what epsilon, postures and workers give: `python -m experiments.ablate_high`."""

import dataclasses
import pathlib
from collections.abc import Callable

from eihrl_jax import base
from eihrl_jax.config import checks, presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import high as high_config
from eihrl_jax.drawing import curves
from eihrl_jax.evaluation import tables
from eihrl_jax.reporting import cached_runs, comparison, sections
from eihrl_jax.training import high

Change = Callable[[high_config.HighConfig], high_config.HighConfig]


def _task(**options: object) -> Change:
    return lambda preset: dataclasses.replace(
        preset, task=dataclasses.replace(preset.task, **options)
    )


def _network(**options: object) -> Change:
    return lambda preset: dataclasses.replace(
        preset, network=dataclasses.replace(preset.network, **options)
    )


def _learner(**options: object) -> Change:
    return lambda preset: dataclasses.replace(
        preset, learner=dataclasses.replace(preset.learner, **options)
    )


VARIANTS: dict[str, Change] = {
    "preset": lambda preset: preset,
    "epsilon 0": _task(sigma=0.0),
    "epsilon 0.15": _task(sigma=0.15),
    "epsilon 0.6": _task(sigma=0.6),
    "one posture": _task(num_postures=1),
    "1 worker": _learner(num_workers=1),
    "4 workers": _learner(num_workers=4),
    "16 workers": _learner(num_workers=16),
    "256 workers": _learner(num_workers=256),
}
"""What is changed, one thing at a time, by name; the presets have an epsilon of 0.3 units."""

PLANNER_VARIANTS: dict[str, Change] = {
    "preset": lambda preset: preset,
    "epsilon 0": _task(sigma=0.0),
    "no optimism": _network(optimism=0.0),
    "cells alone": _network(around="nothing"),
    "corners too": _network(around="corners"),
    "entropy 0.02": _learner(entropy=0.02),
    "view of 9 units": _task(extent=9.0, pixels=15),
}
"""The same for presets that plan on a map, which see no postures."""


def variants(preset: str) -> dict[str, Change]:
    """Returns what is changed of a preset."""
    plans = presets.HIGH[preset].network.kind == "planner"
    return PLANNER_VARIANTS if plans else VARIANTS


@dataclasses.dataclass(frozen=True, kw_only=True)
class AblationConfig:
    """Trains a preset of the high level with one thing changed at a time, and compares.

    Every variant is trained on the Random Square for the same number of updates, then evaluated
    unchanged in the mazes of Table 1, beside uniform directions (RAND-H). Runs and evaluations that
    the folder already holds are continued or taken as they are. Writes table.md and curves.png from
    all variants that are there.

    Attributes:
      preset: of `train_high`; `paper` has 64 workers and sees postures, `best` plans on a map.
      variants: what to train; default: everything, which depends on the preset.
      seeds: of the training runs of each variant.
      num_updates: of each run, a multiple of the preset's `log_every`; None: the preset's.
      robot: that walks.
      movement: of the evaluation; oracle moves with an epsilon of 0.3 units whatever it was trained
        with.
      episodes: per maze.
      out: folder of the runs and the results.
    """

    preset: str = "paper"
    variants: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0, 1, 2)
    num_updates: int | None = None
    robot: str = "ant"
    movement: tuple[base.MovementName, ...] = base.MOVEMENTS
    episodes: int = 500
    out: pathlib.Path = pathlib.Path("runs/ablation-high")

    def __post_init__(self) -> None:
        """Checks names and ranges."""
        checks.one_of("preset", self.preset, tuple(presets.HIGH))
        if self.variants:
            checks.each_of("variants", self.variants, tuple(variants(self.preset)))
        checks.seeds(self.seeds)
        checks.each_of("movement", self.movement, base.MOVEMENTS)
        checks.in_range("episodes", self.episodes, 1, 1_000_000)
        if self.num_updates is not None:
            every = presets.HIGH[self.preset].log_every
            checks.divides("log_every", every, "num_updates", self.num_updates)


def main(config: AblationConfig) -> None:
    """Trains and evaluates what is missing, then compares what is there."""
    chosen = config.variants or tuple(variants(config.preset))
    for seed in config.seeds:
        for name in chosen:
            cached_runs.finish(_options(config, name, seed), high.train)
    for name in (*chosen, sections.RAND_H):
        cached_runs.evaluated(_evaluation(config, name))
    table = compare(config)
    (config.out / "table.md").write_text(table)
    print(table)


def compare(config: AblationConfig) -> str:
    """Draws the learning curves of finished runs, and returns the table of what was evaluated."""
    drawn = {}
    for name in variants(config.preset):
        wanted = [_options(config, name, seed) for seed in config.seeds]
        files = [
            options.run / "metrics.csv" for options in wanted if cached_runs.is_finished(options)
        ]
        if files:
            drawn[name] = [curves.read(file, "step", "eval/success") for file in files]
    curves.save_spread(
        config.out / "curves.png",
        drawn,
        x_label="updates",
        y_label="success while training, %",
        y_scale=100.0,
    )
    evaluations = {
        name: _evaluation(config, name) for name in (*variants(config.preset), sections.RAND_H)
    }
    found = {
        name: cached_runs.evaluated(options)
        for name, options in evaluations.items()
        if options.out.exists()
    }
    rows = [
        comparison.Row(f"{name}, {movement}", comparison.select(cells, movement=movement))
        for movement in config.movement
        for name, cells in found.items()
    ]
    title = f"Preset {config.preset}, one thing changed at a time"
    return comparison.success_by_maze(title, rows, tuple(tables.TABLE1_MAZES)).markdown() + "\n"


def _options(config: AblationConfig, name: str, seed: int) -> high_config.HighConfig:
    run = config.out / _folder(name) / f"seed-{seed}"
    options = dataclasses.replace(presets.HIGH[config.preset], seed=seed, run=run, resume=True)
    if config.num_updates is not None:
        learner = dataclasses.replace(options.learner, num_updates=config.num_updates)
        options = dataclasses.replace(options, learner=learner)
    return variants(config.preset)[name](options)


def _evaluation(config: AblationConfig, name: str) -> evaluate_config.EvaluateConfig:
    """Returns the options with which what was trained alike is evaluated."""
    highs = (evaluate_config.UNIFORM,)
    if name != sections.RAND_H:
        highs = tuple(str(_options(config, name, seed).run) for seed in config.seeds)
    return evaluate_config.EvaluateConfig(
        mazes=tuple(tables.TABLE1_MAZES),
        robot=(config.robot,),
        movement=config.movement,
        high=highs,
        episodes=config.episodes,
        out=config.out / "evaluations" / _folder(name),
        animate="none",
        heatmaps=False,
    )


def _folder(name: str) -> str:
    return name.replace(" ", "-")
