"""Tables of success rates for the terminal and for Markdown, beside the paper's figures."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import rich.table

from eihrl_jax.evaluation import results, statistics

TABLE1_MAZES = {"random": "Maze-ori", "g1": "Maze-g1", "g2": "Maze-g2", "g3": "Maze-g3"}
"""Our names of the mazes of the paper's Table 1, and the paper's."""

PAPER_TABLE1 = {
    "full": {"random": (51.8, 4.4), "g1": (45.6, 5.2), "g2": (27.8, 6.7), "g3": (73.6, 4.6)},
    "oracle": {"random": (66.4, 5.4), "g1": (72.0, 6.3), "g2": (58.4, 8.3), "g3": (84.8, 6.6)},
}
"""Zero-shot success of the paper's method in per cent with its plus-minus, by movement."""

PAPER_NAMES = {"full": "Ours", "oracle": "Ours-Oracle"}
"""What the paper calls its method, by movement."""

_MOVEMENT_NAMES = {"oracle": "oracle movement", "full": "walking"}


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
      title: what stands above it.
      header: names of the columns.
      rows: one text per column; a row whose first text is indented belongs to the one above it.
    """

    title: str
    header: list[str]
    rows: list[list[str]]


def percent(success: statistics.Success) -> str:
    """Formats a success rate with its interval: "66.4 [62.1, 70.4]"."""
    return f"{100 * success.rate:.1f} [{100 * success.low:.1f}, {100 * success.high:.1f}]"


def _by_maze(cells: Sequence[results.Cell]) -> Table:
    """Returns the general table: one row for each result."""
    header = ["maze", "robot", "movement", "high level", "low level", "success % [95 %]"]
    header += ["± blocks", "± seeds", "return", "decisions", "falls", "episodes"]
    rows = []
    for cell in cells:
        system = cell.system
        rates = cell.seed_rates
        spread = _percent(statistics.over_runs(np.array(rates)).std if len(rates) > 1 else None)
        rows.append(
            [
                cell.maze,
                system.robot,
                system.movement,
                system.high,
                system.low or "-",
                percent(cell.success),
                _percent(cell.success.block_std),
                spread,
                f"{cell.return_mean:.2f}",
                f"{cell.decisions_mean:.1f} / {cell.num_decisions}",
                str(cell.num_falls) if system.movement == "full" else "-",
                str(cell.num_episodes),
            ]
        )
    return Table("Success by maze", header, rows)


def _percent(value: float | None) -> str:
    """Formats a rate in per cent, a dash where there is none."""
    return "-" if value is None else f"{100 * value:.1f}"


def _table1(cells: Sequence[results.Cell]) -> Table:
    """Returns Table 1: ours with interval, ours with block deviation, the paper's."""
    cells = [cell for cell in cells if cell.maze in TABLE1_MAZES]
    mazes = [name for name in TABLE1_MAZES if any(cell.maze == name for cell in cells)]
    header = ["", *(TABLE1_MAZES[name] for name in mazes)]
    rows = []
    for system in dict.fromkeys(cell.system for cell in cells):
        found = {cell.maze: cell.success for cell in cells if cell.system == system}
        label = f"{system.high}, {_MOVEMENT_NAMES[system.movement]} ({system.robot})"
        rows.append([label, *(percent(found[m]) if m in found else "-" for m in mazes)])
        blocks = {m: f"± {_percent(s.block_std)}" for m, s in found.items()}
        rows.append(["  ± over five blocks", *(blocks.get(m, "-") for m in mazes)])
        if system.robot == "ant" and system.high != "random":
            figures = PAPER_TABLE1[system.movement]
            paper = [f"{figures[m][0]:.1f} ± {figures[m][1]:.1f}" for m in mazes]
            rows.append([f"  paper, {PAPER_NAMES[system.movement]}", *paper])
    return Table("Table 1: zero-shot success in %, 95 % interval", header, rows)


def over_runs(
    cells: Sequence[results.Cell],
) -> dict[tuple[str, str, str], statistics.RunSpread]:
    """Summarises learned high levels over training runs, by maze, robot and movement.

    Args:
      cells: results of high levels that were trained alike from different seeds.

    Returns:
      One entry for each maze, robot and movement in which two or more high levels were evaluated.
    """
    groups: dict[tuple[str, str, str], list[float]] = {}
    for cell in cells:
        if cell.system.high != "random":
            key = (cell.maze, cell.system.robot, cell.system.movement)
            groups.setdefault(key, []).append(cell.success.rate)
    return {
        key: statistics.over_runs(np.array(rates))
        for key, rates in groups.items()
        if len(rates) > 1
    }


def _over_runs(cells: Sequence[results.Cell]) -> Table:
    """Returns the table of `over_runs`."""
    rows = [
        [
            *key,
            f"{100 * spread.mean:.1f} ± {100 * spread.std:.1f}",
            f"[{100 * spread.low:.1f}, {100 * spread.high:.1f}]",
        ]
        for key, spread in over_runs(cells).items()
    ]
    header = ["maze", "robot", "movement", "mean ± std over runs, %", "95 % of the mean"]
    return Table("Success over training runs", header, rows)


def _tables(cells: Sequence[results.Cell]) -> list[Table]:
    """Returns those tables for which there is something to show."""
    tables = [_by_maze(cells), _table1(cells), _over_runs(cells)]
    return [table for table in tables if table.rows]


def terminal(cells: Sequence[results.Cell]) -> list[rich.table.Table]:
    """Returns the tables of an evaluation for a `rich` console."""
    tables = []
    for table in _tables(cells):
        shown = rich.table.Table(title=table.title, title_justify="left", header_style="bold")
        for i, name in enumerate(table.header):
            shown.add_column(name, justify="left" if i == 0 else "right")
        for row in table.rows:
            shown.add_row(*row, style="dim" if row[0].startswith("  ") else None)
        tables.append(shown)
    return tables


def markdown(cells: Sequence[results.Cell]) -> str:
    """Returns the tables of an evaluation as Markdown."""
    parts = []
    for table in _tables(cells):
        rule = ["---"] * len(table.header)
        lines = [f"| {' | '.join(row)} |" for row in [table.header, rule, *table.rows]]
        parts.append("\n".join([f"**{table.title}**", "", *lines]))
    return "\n\n".join(parts) + "\n"
