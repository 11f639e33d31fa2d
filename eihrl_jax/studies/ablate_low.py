"""Measures what each option of the low level gains: `python -m experiments.ablate_low`."""

import pathlib
import statistics
from typing import Annotated

import numpy as np
from jaxtyping import Float

from eihrl_jax import base
from eihrl_jax.config import changes, checks, limits, presets
from eihrl_jax.config import low as low_config
from eihrl_jax.drawing import curves, figures
from eihrl_jax.evaluation import tables
from eihrl_jax.storage import writing
from eihrl_jax.studies import ablation
from eihrl_jax.training import low

VARIANTS: dict[str, dict[str, object]] = {
    "restarted steps": {},
    "best: no relabelling": {"relabel": "never"},
    "direction frame": {"low_input.frame": "direction"},
    "world frame": {"low_input.frame": "world"},
    "no progress": {"low_input.use_progress": False},
    "velocities unscaled": {"low_input.velocity_scale": 1.0},
    "relabelled direction": {"relabel": "direction", "relabel_share": 1.0},
    "reward of eq. 1": {"reward.lateral_weight": 0.0, "reward.beyond_cell": 1.0},
    "actor not averaged": {"droq.average_rate": 1.0},
    "falls cost 10": {"reward.fall_cost": 10.0},
    "falls end nothing": {"ends_at_fall": False},
    "no inner walls": {"num_rooms": 0},
}
"""What is changed in `presets.low_restarting`, one thing at a time, by name."""

_DISTANCE_OF = ("along_mean", "along_std", "lateral_mean", "lateral_std")
_SHOWN = ("along_mean", "along_std", "lateral_std", "falls")
"""Columns of the metrics, but for their `eval/`."""


@limits.dataclass
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
    variants: limits.Several[Annotated[str, limits.OneOf(VARIANTS)]] = tuple(VARIANTS)
    seeds: limits.Seeds = (0, 1, 2)
    num_iterations: Annotated[int, limits.Range(500, 2**31 - 1)] = 4_000
    out: pathlib.Path = pathlib.Path("runs/ablation")

    def __post_init__(self) -> None:
        """Checks that a run ends with an evaluation."""
        every = presets.low_best().evaluate_every
        checks.divides("evaluate_every", every, "num_iterations", self.num_iterations)


def main(config: AblationConfig) -> None:
    """Trains what is missing, then compares what is there."""
    _runs(config).train(config.variants, low.train)
    table = compare(config)
    writing.write_text(config.out / "table.md", table)
    print(table)


def compare(config: AblationConfig) -> str:
    """Draws the learning curves of finished runs, and returns the table of their ends."""
    finished = _runs(config).finished()
    drawn = {variant: [error_curve(file) for file in files] for variant, files in finished.items()}
    path = config.out / "curves.png"
    y_label = "distance from one cell ahead, root mean square, units"

    def draw() -> None:
        curves.save_spread(path, drawn, x_label="critic updates", y_label=y_label)

    figures.attempt(path, draw)

    header = ["changed", "runs", "distance", "along", "std", "sideways std", "falls per 1,000"]
    rows = []
    for variant, files in finished.items():
        # One value per seed, the last one of its run.
        ends = [[curve[-1, 1] for curve in drawn[variant]]]
        ends += [[_column(file, name)[-1, 1] for file in files] for name in _SHOWN]
        rows.append([variant, str(len(files)), *map(_spread, ends)])
    return tables.markdown_grid(header, rows) + "\n"


def error_curve(metrics: pathlib.Path) -> Float[np.ndarray, "N 2"]:
    """Returns critic updates and how far subgoals ended from one cell ahead, root mean square."""
    columns = [_column(metrics, name) for name in _DISTANCE_OF]
    along, along_std, lateral, lateral_std = (column[:, 1] for column in columns)
    # The mean square distance is that of the means and the variances around them.
    square = (along - base.CELL) ** 2 + along_std**2 + lateral**2 + lateral_std**2
    updates = presets.low_best().updates_per_iteration * columns[0][:, 0]
    return np.stack([updates, np.sqrt(square)], -1)


def _column(metrics: pathlib.Path, name: str) -> Float[np.ndarray, "N 2"]:
    """Returns iterations and what was measured after them."""
    return curves.read(metrics, "step", f"eval/{name}")


def _spread(values: list[float]) -> str:
    """Writes a mean, with the standard deviation of several runs."""
    mean = f"{statistics.mean(values):.2f}"
    return mean if len(values) < 2 else f"{mean} ± {statistics.stdev(values):.2f}"


def _runs(config: AblationConfig) -> ablation.Ablation[low_config.LowConfig]:
    """Returns all runs that may be compared."""
    budget = {"robot": config.robot, "num_iterations": config.num_iterations}
    preset = changes.apply(presets.low_restarting(), budget)
    return ablation.Ablation(preset=preset, variants=VARIANTS, seeds=config.seeds, out=config.out)
