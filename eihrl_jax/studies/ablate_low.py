"""Measures what each option of the low level gains: `python -m experiments.ablate_low`."""

import dataclasses
import pathlib
import statistics
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.config import checks, presets
from eihrl_jax.config import low as low_config
from eihrl_jax.drawing import curves
from eihrl_jax.reporting import cached_runs
from eihrl_jax.training import low

Change = Callable[[low_config.LowConfig], low_config.LowConfig]


def _input(**options: object) -> Change:
    return lambda best: dataclasses.replace(
        best, low_input=dataclasses.replace(best.low_input, **options)
    )


def _reward(**options: object) -> Change:
    return lambda best: dataclasses.replace(
        best, reward=dataclasses.replace(best.reward, **options)
    )


def _droq(**options: object) -> Change:
    return lambda best: dataclasses.replace(best, droq=dataclasses.replace(best.droq, **options))


def _run(**options: object) -> Change:
    return lambda best: dataclasses.replace(best, **options)


VARIANTS: dict[str, Change] = {
    "restarted steps": lambda restarting: restarting,
    "best: no relabelling": _run(relabel="never"),
    "direction frame": _input(frame="direction"),
    "world frame": _input(frame="world"),
    "no progress": _input(use_progress=False),
    "velocities unscaled": _input(velocity_scale=1.0),
    "relabelled direction": _run(relabel="direction", relabel_share=1.0),
    "reward of eq. 1": _reward(lateral_weight=0.0, beyond_cell=1.0),
    "actor not averaged": _droq(average_rate=1.0),
    "falls cost 10": _reward(fall_cost=10.0),
    "falls end nothing": _run(ends_at_fall=False),
    "no inner walls": _run(num_rooms=0),
}
"""What is changed in `presets.low_restarting`, one thing at a time, by name."""

MEASURED = ("along_mean", "along_std", "lateral_mean", "lateral_std", "falls")


@dataclasses.dataclass(frozen=True, kw_only=True)
class AblationConfig:
    """Trains with one option changed at a time, and compares.

    What is changed is preset `best` with restarted steps, which it had before this comparison.

    Runs that the folder already holds are continued or taken as they are. Writes table.md and
    curves.png from all variants that are there.

    Attributes:
      robot: which robot.
      variants: what to train; default: everything.
      seeds: of the training runs of each variant.
      num_iterations: budget of each run, see `train_low`.
      out: folder of the runs and the results.
    """

    robot: str = "ant"
    variants: tuple[str, ...] = tuple(VARIANTS)
    seeds: tuple[int, ...] = (0, 1, 2)
    num_iterations: int = 4_000
    out: pathlib.Path = pathlib.Path("runs/ablation")

    def __post_init__(self) -> None:
        """Checks names and ranges."""
        checks.each_of("variants", self.variants, tuple(VARIANTS))
        checks.seeds(self.seeds)
        checks.in_range("num_iterations", self.num_iterations, 500, 2**31 - 1)
        every = presets.low_best().evaluate_every
        checks.divides("evaluate_every", every, "num_iterations", self.num_iterations)


def main(config: AblationConfig) -> None:
    """Trains what is missing, then compares what is there."""
    for seed in config.seeds:
        for name in config.variants:
            cached_runs.finish(_options(config, name, seed), low.train)
    table = compare(config)
    (config.out / "table.md").write_text(table)
    print(table)


def compare(config: AblationConfig) -> str:
    """Draws the learning curves of finished runs, and returns the table of their ends."""
    drawn, rows = {}, []
    for name in VARIANTS:
        wanted = [_options(config, name, seed) for seed in config.seeds]
        folders = [options.run for options in wanted if cached_runs.is_finished(options)]
        if folders:
            drawn[name] = [error_curve(folder / "metrics.csv") for folder in folders]
            rows.append(_row(name, folders, [curve[-1, 1] for curve in drawn[name]]))
    curves.save_spread(
        config.out / "curves.png",
        drawn,
        x_label="critic updates",
        y_label="distance from one cell ahead, root mean square, units",
    )
    header = ["changed", "runs", "distance", "along", "std", "sideways std", "falls per 1,000"]
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def error_curve(metrics: pathlib.Path) -> Float[np.ndarray, "N 2"]:
    """Returns critic updates and how far subgoals ended from one cell ahead, root mean square."""
    per_iteration = presets.low_best().updates_per_iteration
    columns = {name: curves.read(metrics, "step", f"eval/{name}") for name in MEASURED[:4]}
    along, along_std, lateral, lateral_std = (column[:, 1] for column in columns.values())
    square = (along - base.CELL) ** 2 + along_std**2 + lateral**2 + lateral_std**2
    return np.stack([per_iteration * columns["along_mean"][:, 0], np.sqrt(square)], -1)


def _row(name: str, folders: list[pathlib.Path], errors: list[float]) -> list[str]:
    ends = {
        measured: [
            float(curves.read(folder / "metrics.csv", "step", f"eval/{measured}")[-1, 1])
            for folder in folders
        ]
        for measured in MEASURED
    }
    shown = [ends[measured] for measured in ("along_mean", "along_std", "lateral_std", "falls")]
    return [name, str(len(folders)), *map(_spread, [errors, *shown])]


def _spread(values: list[float]) -> str:
    """Writes a mean, with the standard deviation of several runs."""
    mean = f"{statistics.mean(values):.2f}"
    return mean if len(values) < 2 else f"{mean} ± {statistics.stdev(values):.2f}"


def _options(config: AblationConfig, name: str, seed: int) -> low_config.LowConfig:
    restarting = dataclasses.replace(
        presets.low_restarting(),
        robot=config.robot,
        num_iterations=config.num_iterations,
        seed=seed,
        run=config.out / _folder(name) / f"seed-{seed}",
        resume=True,
    )
    return VARIANTS[name](restarting)


def _folder(name: str) -> str:
    return name.replace(" ", "-").replace(".", "").replace(":", "")
