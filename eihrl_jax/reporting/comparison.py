"""Tables that set several evaluations side by side, with the paper's figures among them.

What stands in a row was evaluated alike: one robot, one movement, and high levels that were trained
alike from different seeds, over which mean and standard deviation are taken.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from eihrl_jax.evaluation import paper, results, statistics, tables

NOTE = (
    "Success is achieved goals / total goals in per cent: mean ± standard deviation over high "
    "levels trained alike from different seeds; the paper's ± is its own."
)


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


def select(
    cells: Sequence[results.Cell], *, movement: str, robot: str | None = None
) -> list[results.Cell]:
    """Picks the results of one movement, and of one robot where it is named."""
    return [
        cell
        for cell in cells
        if cell.agent.movement == movement and robot in (None, cell.agent.robot)
    ]


def success_by_maze(title: str, rows: Sequence[Row], mazes: Sequence[str]) -> tables.Table:
    """Compares success in several mazes."""
    body = [
        [
            row.label,
            *(_entry(row, maze, [c for c in row.cells if c.maze == maze]) for maze in mazes),
        ]
        for row in rows
    ]
    names = [tables.TABLE1_MAZES.get(maze, maze) for maze in mazes]
    return tables.Table(title, ["success %", *names], body)


def success_by_robot(title: str, rows: Sequence[Row], robots: Sequence[str]) -> tables.Table:
    """Compares success of several robots in one maze."""
    body = [
        [
            row.label,
            *(
                _entry(row, robot, [c for c in row.cells if c.agent.robot == robot])
                for robot in robots
            ),
        ]
        for row in rows
    ]
    return tables.Table(title, ["success %", *robots], body)


def overall(title: str, rows: Sequence[Row]) -> tables.Table:
    """Compares success over all mazes taken together."""
    return tables.Table(title, ["", "success %"], [[row.label, mean(row.cells)] for row in rows])


def failures(title: str, rows: Sequence[Row]) -> tables.Table:
    """Says how episodes ended: per cent by `results.OUTCOMES`, maze by maze."""
    body = []
    for row in rows:
        for maze in dict.fromkeys(cell.maze for cell in row.cells):
            here = [cell.outcomes for cell in row.cells if cell.maze == maze]
            counts = np.array([[getattr(o, name) for name in results.OUTCOMES] for o in here]).sum(
                0
            )
            shares = [f"{share:.1f}" for share in 100.0 * counts / counts.sum()]
            body.append([row.label, tables.TABLE1_MAZES.get(maze, maze), *shares])
    return tables.Table(title, ["% of episodes", "maze", *results.OUTCOMES], body)


def mean(cells: Sequence[results.Cell]) -> str:
    """Writes the mean success of some results, and its deviation over their high levels.

    Where there is one high level, uniform or learned, nothing is known about the deviation.
    """
    by_high: dict[str, list[float]] = {}
    for cell in cells:
        by_high.setdefault(cell.agent.high, []).append(cell.success.rate)
    if not by_high:
        return "-"
    rates = np.array([np.mean(rates) for rates in by_high.values()])
    if len(rates) == 1:
        return f"{100 * rates[0]:.1f}"
    return tables.spread(statistics.over_runs(rates))


def _entry(row: Row, column: str, cells: Sequence[results.Cell]) -> str:
    if row.published is not None:
        return paper.percent(row.published.get(column))
    return mean(cells)
