"""Tables that set several evaluations side by side, with the paper's figures among them.

What stands in a row was evaluated alike: one robot, one movement, and high levels that were trained
alike from different seeds, over which mean and standard deviation are taken.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.evaluation import paper, results, statistics, tables

NOTE = (
    "Success is achieved goals / total goals in per cent: mean ± standard deviation over high "
    "levels trained alike from different seeds, and in brackets the 95 % interval of the mean, at "
    "least as wide as that of one high level's episodes; the paper's ± is its own."
)

MOVEMENTS = {"oracle": "oracle", "full": "walking"}
"""How rows call the movements, in their order."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of a table.

    Attributes:
      label: what stands at its head.
      cells: results of one robot and movement with one or more high levels.
      published: the paper's figures by column instead of results.
    """

    label: str
    cells: Sequence[results.Cell] = ()
    published: Mapping[str, paper.Figure] | None = None


def select(cells: Sequence[results.Cell], movement: str) -> list[results.Cell]:
    """Picks the results of one movement."""
    return [cell for cell in cells if cell.agent.movement == movement]


def by_movement(
    evaluated: Mapping[str, Sequence[results.Cell]], movements: Sequence[str] = tuple(MOVEMENTS)
) -> list[Row]:
    """Returns a row for each label and movement that was evaluated, label by label."""
    return [
        Row(f"{label}, {MOVEMENTS[movement]}", here)
        for label, cells in evaluated.items()
        for movement in movements
        if (here := select(cells, movement))
    ]


def of_variants(title: str, evaluated: Mapping[str, Sequence[results.Cell]]) -> tables.Table:
    """Compares what trainings with one thing changed reach, movement by movement.

    Beside the classical search it is compared in whatever mazes it was evaluated in, else in those
    of Table 1.
    """
    if evaluate_config.FRONTIER in evaluated:
        return of_searches(title, evaluated, evaluate_config.FRONTIER)

    # Movement by movement: variants are compared under the same movement.
    rows = [row for movement in MOVEMENTS for row in by_movement(evaluated, (movement,))]
    return success_by_maze(title, rows, tuple(tables.TABLE1_MAZES))


def of_searches(
    title: str, evaluated: Mapping[str, Sequence[results.Cell]], reference: str
) -> tables.Table:
    """Compares searches in many mazes: success, and decisions over those of a reference.

    Args:
      title: of the table.
      evaluated: results by label; movements are told apart.
      reference: the label whose decisions the others' are divided by, maze by maze.

    Returns:
      A table with a column for each kind of maze: its name up to the numbers at its end.
    """
    kinds = list(dict.fromkeys(_kind(cell) for cells in evaluated.values() for cell in cells))
    header = ["success %, decisions / reference"]
    body = []
    for movement in MOVEMENTS:
        costs = {cell.maze: cell for cell in select(evaluated.get(reference, ()), movement)}
        for row in by_movement(evaluated, (movement,)):
            parts = [[cell for cell in row.cells if _kind(cell) == kind] for kind in kinds]
            body.append([row.label, *(f"{mean(part)}, {_relative(part, costs)}" for part in parts)])
    return tables.Table(title, [*header, *kinds], body)


def _kind(cell: results.Cell) -> str:
    """Returns the name of a maze without the numbers at its end."""
    return re.sub(r"(-\d+)+$", "", cell.maze)


def _relative(cells: Sequence[results.Cell], costs: Mapping[str, results.Cell]) -> str:
    """Writes the mean over mazes of decisions over a reference's in the same maze."""
    ratios = [
        cell.decisions_mean / costs[cell.maze].decisions_mean
        for cell in cells
        if cell.maze in costs
    ]
    return f"{np.mean(ratios):.3f}" if ratios else "-"


def success_by_maze(title: str, rows: Sequence[Row], mazes: Sequence[str]) -> tables.Table:
    """Compares success in several mazes."""
    # Mazes of Table 1 are called as the paper calls them.
    names = {maze: tables.TABLE1_MAZES.get(maze, maze) for maze in mazes}
    return _success(title, rows, names, lambda cell: cell.maze)


def success_by_robot(title: str, rows: Sequence[Row], robots: Sequence[str]) -> tables.Table:
    """Compares success of several robots in one maze."""
    return _success(title, rows, {name: name for name in robots}, lambda cell: cell.agent.robot)


def _success(
    title: str,
    rows: Sequence[Row],
    columns: Mapping[str, str],
    column_of: Callable[[results.Cell], str],
) -> tables.Table:
    """Compares success; `columns` are what `column_of` tells cells apart by, and their heads."""
    body = []
    for row in rows:
        # What was published has no episodes of which a mean could be taken.
        entries = [
            _with_interval([cell for cell in row.cells if column_of(cell) == column])
            if row.published is None
            else paper.percent(row.published.get(column))
            for column in columns
        ]
        body.append([row.label, *entries])
    return tables.Table(title, ["success %", *columns.values()], body)


def overall(title: str, rows: Sequence[Row]) -> tables.Table:
    """Compares success over all mazes taken together."""
    return tables.Table(
        title, ["", "success %"], [[row.label, _with_interval(row.cells)] for row in rows]
    )


def failures(title: str, rows: Sequence[Row]) -> tables.Table:
    """Says how episodes ended: per cent by `results.OUTCOMES`, maze by maze."""
    body = []
    for row in rows:
        for maze in dict.fromkeys(cell.maze for cell in row.cells):
            here = [cell.outcomes for cell in row.cells if cell.maze == maze]
            # Counts are added up before they are divided: cells may have different episodes.
            counts = [sum(getattr(o, name) for o in here) for name in results.OUTCOMES]
            shares = [f"{100.0 * count / sum(counts):.1f}" for count in counts]
            body.append([row.label, tables.TABLE1_MAZES.get(maze, maze), *shares])
    return tables.Table(title, ["% of episodes", "maze", *results.OUTCOMES], body)


def mean(cells: Sequence[results.Cell]) -> str:
    """Writes the mean success of some results, and its deviation over their high levels.

    Where there is one high level, uniform or learned, nothing is known about the deviation.
    """
    rates = _by_training(cells)
    if len(rates) < 2:
        return f"{100 * rates[0]:.1f}" if len(rates) else "-"
    return tables.spread(statistics.over_runs(rates))


def _with_interval(cells: Sequence[results.Cell]) -> str:
    """Writes the same with its 95 % interval: "95.0 ± 1.2 [91.8, 97.5]"."""
    if not cells:
        return "-"
    # As wide as that of single episodes: trainings that all came out alike would show no doubt.
    low = float(np.mean([cell.success.low for cell in cells]))
    high = float(np.mean([cell.success.high for cell in cells]))
    rates = _by_training(cells)
    if len(rates) > 1:
        over = statistics.over_runs(rates)
        low, high = min(low, over.low), max(high, over.high)
    return f"{mean(cells)} [{100 * low:.1f}, {100 * high:.1f}]"


def _by_training(cells: Sequence[results.Cell]) -> Float[np.ndarray, " N"]:
    """Returns the success of each of N high levels, the mean over its mazes."""
    by_high: dict[str, list[float]] = {}
    for cell in cells:
        by_high.setdefault(cell.agent.high, []).append(cell.success.rate)
    return np.array([np.mean(rates) for rates in by_high.values()])
