"""Tables of success rates for the terminal and for Markdown, beside the paper's figures."""

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import rich.box
import rich.console
import rich.measure
import rich.table

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.envs import subgoals
from eihrl_jax.evaluation import paper, results, statistics
from eihrl_jax.evaluation import standing as standing_lib
from eihrl_jax.mazes import suites

TABLE1_MAZES = {"random": "Maze-ori", "g1": "Maze-g1", "g2": "Maze-g2", "g3": "Maze-g3"}
"""Our names of the mazes in the paper's Table 1, and the paper's names."""

NOTE = (
    "Success is the share of goals that are reached, ± its standard deviation over five blocks of "
    "episodes, with Wilson's 95 % interval. Episodes fail because time is up while the robot is "
    "upright (late), because it has fallen, or because its simulation became unstable (unstable)."
)
"""Explains the numbers of the tables."""

_FAILED = "late / fallen / unstable"
_ANY_WIDTH = 10_000  # characters: wider than any table
MOVEMENT_NAMES = {"oracle": "oracle movement", "full": "walking"}


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
      title: shown above it.
      header: names of the columns.
      rows: one text per column; a row whose first text is indented gives details of the one above.
      num_words: how many of the first columns are words, aligned left; numbers are aligned right.
    """

    title: str
    header: list[str]
    rows: list[list[str]]
    num_words: int = 1

    def markdown(self) -> str:
        """Returns the table as Markdown, its title in bold."""
        return f"**{_escaped(self.title)}**\n\n{markdown_grid(self.header, self.rows)}"


def markdown_grid(header: list[str], rows: Iterable[list[str]]) -> str:
    """Returns a Markdown table without title.

    >>> print(markdown_grid(["maze", "success %"], [["u", "98.2"]]))
    | maze | success % |
    | --- | --- |
    | u | 98.2 |
    """
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(_escaped, line))} |" for line in lines)


def _escaped(text: str) -> str:
    """Escapes a text, so that Markdown shows it as it is, also in a table's cell."""
    return re.sub(r"([\\`|<])", r"\\\1", base.printable(text))


def percent(success: statistics.Success) -> str:
    """Formats a success rate in per cent with the deviation of its blocks: "66.4 ± 5.4"."""
    rate = f"{100 * success.rate:.1f}"
    return rate if success.block_std is None else f"{rate} ± {100 * success.block_std:.1f}"


def interval(success: statistics.Success | statistics.RunSpread) -> str:
    """Formats a success rate's interval in per cent: "[62.1, 70.4]"."""
    return f"[{100 * success.low:.1f}, {100 * success.high:.1f}]"


def spread(over: statistics.RunSpread) -> str:
    """Formats success over training runs in per cent: "66.4 ± 5.4"."""
    return f"{100 * over.mean:.1f} ± {100 * over.std:.1f}"


def _by_agent(cells: Sequence[results.Cell]) -> list[Table]:
    """Returns a table per agent, a row per maze; a whole suite's mean stands above its mazes."""
    # Rows keep the order of the cells, which is that of the evaluation.
    header = ["maze", "success %", "95 %", "return", "decisions", "path ratio", _FAILED, "episodes"]
    by_agent: dict[results.Agent, dict[str, results.Cell]] = {}
    for cell in cells:
        by_agent.setdefault(cell.agent, {})[cell.maze] = cell

    tables = []
    for agent, by_maze in by_agent.items():
        whole = suites.complete(by_maze)
        suite_of = {maze: suite for suite, own in whole.items() for maze in own}
        body = []
        for maze, cell in by_maze.items():
            suite = suite_of.get(maze)
            # Above the first of its mazes, and only once.
            if suite in whole:
                body.append(_suite_row(suite, [by_maze[name] for name in whole.pop(suite)]))
            body.append(_maze_row(cell, "  " if suite else ""))
            if len(cell.goal_rates) > 1:
                body.append(_goal_row(cell, len(header)))
        tables.append(Table(_title(agent), header, body))
    return tables


def _maze_row(cell: results.Cell, indent: str) -> list[str]:
    """Returns a maze's row of an agent's table."""
    return [
        indent + cell.maze,
        percent(cell.success),
        interval(cell.success),
        f"{cell.return_mean:.2f}",
        f"{cell.decisions_mean:.1f} / {cell.num_decisions}",
        _path_ratio([cell]),
        _failures([cell]),
        str(cell.num_episodes),
    ]


def _goal_row(cell: results.Cell, num_columns: int) -> list[str]:
    """Returns the row below a maze's, with the share of episodes that reached each of its goals."""
    rates = " / ".join(f"{100 * rate:.0f}" for rate in cell.goal_rates)
    return ["  goal by goal, %", rates, *[""] * (num_columns - 2)]


def _suite_row(suite: str, cells: Sequence[results.Cell]) -> list[str]:
    """Returns a suite's row of an agent's table: means with equal weight for every maze."""
    return [
        f"{suite}, mean of {len(cells)}",
        f"{100 * np.mean([cell.success.rate for cell in cells]):.1f}",
        "-",
        f"{np.mean([cell.return_mean for cell in cells]):.2f}",
        f"{np.mean([cell.decisions_mean for cell in cells]):.1f}",
        _path_ratio(cells),
        _failures(cells),
        str(sum(cell.num_episodes for cell in cells)),
    ]


def _path_ratio(cells: Sequence[results.Cell]) -> str:
    """Returns the mean path ratio over the mazes in which any episode was solved."""
    ratios = [cell.path_ratio for cell in cells if cell.path_ratio is not None]
    return f"{np.mean(ratios):.2f}" if ratios else "-"


def _failures(cells: Sequence[results.Cell]) -> str:
    """Returns the numbers of failed episodes in some mazes, by reason."""
    late, fallen, unstable = (
        str(sum(getattr(cell.outcomes, name) for cell in cells))
        for name in ("late", "fallen", "unstable")
    )
    # Oracle movement can't fall: zeros would look like an achievement.
    return f"{late} / {fallen} / {unstable}" if cells[0].agent.movement == "full" else late


def _title(agent: results.Agent) -> str:
    """Describes an agent."""
    if _is_baseline(agent):
        return f"{agent.robot}, walking, {agent.high}"
    moves = MOVEMENT_NAMES[agent.movement]
    if agent.low is not None:
        moves += f" with low level {agent.low}"
    return f"{agent.robot}, {moves}, high level {agent.high}"


def _is_baseline(agent: results.Agent) -> bool:
    """Returns whether an agent is a baseline, which has both levels in one policy."""
    return agent.movement == "full" and agent.low is None


def _table1(cells: Sequence[results.Cell]) -> list[Table]:
    """Returns Table 1 for each high level, with the paper's figures below ours."""
    # Grouped by high level (a table), agent (its rows) and maze (its columns).
    success: dict[str, dict[results.Agent, dict[str, statistics.Success]]] = {}
    for cell in cells:
        if cell.maze in TABLE1_MAZES:
            agents = success.setdefault(cell.agent.high, {})
            agents.setdefault(cell.agent, {})[cell.maze] = cell.success

    tables = []
    for high, agents in success.items():
        # Those that were evaluated, in the paper's order.
        mazes = [m for m in TABLE1_MAZES if any(m in by_maze for by_maze in agents.values())]
        header = ["success %", *(TABLE1_MAZES[name] for name in mazes)]
        rows = [row for agent, by_maze in agents.items() for row in _rows1(agent, by_maze, mazes)]
        tables.append(Table(f"Table 1, high level {high}", header, rows))
    return tables


def _rows1(
    agent: results.Agent, success: Mapping[str, statistics.Success], mazes: Sequence[str]
) -> list[list[str]]:
    """Returns one agent's rows of Table 1: success rates, intervals, and the paper's rates."""
    # A dash where an agent wasn't evaluated.
    rates = {maze: percent(rate) for maze, rate in success.items()}
    bounds = {maze: interval(rate) for maze, rate in success.items()}
    rows = [
        [f"{agent.robot}, {MOVEMENT_NAMES[agent.movement]}", *(rates.get(m, "-") for m in mazes)],
        ["  95 % interval", *(bounds.get(m, "-") for m in mazes)],
    ]

    # The paper's figures are of the ant with a trained high level.
    if agent.robot == "ant" and agent.high != evaluate_config.UNIFORM and not _is_baseline(agent):
        published = paper.TABLE1[agent.movement]
        label = f"  paper, {paper.NAMES[agent.movement]}"
        rows.append([label, *(paper.percent(published[maze]) for maze in mazes)])
    return rows


def over_runs(
    cells: Sequence[results.Cell],
) -> dict[tuple[str, str, str, str], statistics.RunSpread]:
    """Summarises learned high levels over training runs, by name, maze, robot and movement.

    Args:
      cells: results of agents; high levels whose names differ only in a number at the end, such as
        `best-u-0` and `best-u-1`, are taken as one training from different seeds.

    Returns:
      One entry for each group of at least two runs, whose name ends in `*`, and maze; for a suite
      whose mazes were all evaluated, also one of the means over its mazes.
    """
    by_agent: dict[results.Agent, dict[str, float]] = {}
    for cell in cells:
        if cell.agent.high != evaluate_config.UNIFORM:
            by_agent.setdefault(cell.agent, {})[cell.maze] = cell.success.rate

    groups: dict[tuple[str, str, str, str], list[float]] = {}
    for agent, by_maze in by_agent.items():
        means = {
            suite: float(np.mean([by_maze[maze] for maze in own]))
            for suite, own in suites.complete(by_maze).items()
        }
        for maze, rate in (means | by_maze).items():
            key = (re.sub(r"\d+$", "*", agent.high), maze, agent.robot, agent.movement)
            groups.setdefault(key, []).append(rate)

    return {
        key: statistics.over_runs(np.array(rates))
        for key, rates in groups.items()
        if len(rates) > 1
    }


def _over_runs(cells: Sequence[results.Cell]) -> list[Table]:
    """Returns the table of `over_runs`, if it isn't empty."""
    rows = [[*key, spread(over), interval(over)] for key, over in over_runs(cells).items()]
    header = ["high level", "maze", "robot", "movement", "mean ± std, %", "95 % of the mean"]
    return [Table("Success over training runs", header, rows)] if rows else []


def _tables(cells: Sequence[results.Cell]) -> list[Table]:
    """Returns all tables that aren't empty."""
    return [*_by_agent(cells), *_table1(cells), *_over_runs(cells)]


def terminal(cells: Sequence[results.Cell]) -> list[rich.table.Table]:
    """Returns the tables of an evaluation for a `rich` console."""
    return [on_terminal(table) for table in _tables(cells)]


def on_terminal(table: Table) -> rich.table.Table:
    """Returns a table for a `rich` console."""
    shown = rich.table.Table(
        title=base.printable(table.title),
        title_justify="left",
        header_style="bold",
        box=rich.box.SIMPLE_HEAD,
        pad_edge=False,
    )

    # Numbers are aligned right, and rows of details are dimmed.
    for i, name in enumerate(table.header):
        side = "left" if i < table.num_words else "right"
        shown.add_column(base.printable(name), justify=side, no_wrap=True)
    for row in table.rows:
        style = "dim" if row[0].startswith("  ") else None
        shown.add_row(*map(base.printable, row), style=style)
    return shown


def show(shown: Iterable[rich.table.Table]) -> None:
    """Prints tables in their full width, even where the terminal is narrower."""
    for table in shown:
        # File names may hold brackets and colons, which mustn't be taken for markup or emojis.
        console = rich.console.Console(highlight=False, markup=False, emoji=False)
        options = console.options.update(max_width=_ANY_WIDTH)
        width = rich.measure.Measurement.get(console, options, table).maximum
        console.width = max(console.width, width)
        console.print()
        console.print(table)


def markdown(cells: Sequence[results.Cell]) -> str:
    """Returns the tables of an evaluation as Markdown, with `NOTE` above them."""
    parts = [NOTE, *(table.markdown() for table in _tables(cells))]
    return "\n\n".join(parts) + "\n"


def of_subgoals(measured: Mapping[str, subgoals.Statistics], robot: str) -> rich.table.Table:
    """Returns the table of a low level's statistics by surroundings, for a `rich` console."""
    rows: tuple[tuple[str, Callable[[subgoals.Statistics], str]], ...] = (
        ("subgoals", lambda s: f"{s.num_subgoals:,}"),
        ("  with a wall in the way, %", lambda s: f"{100 * s.blocked:.0f}"),
        ("displacement along, units", lambda s: f"{s.along_mean:.3f}"),
        ("  standard deviation", lambda s: f"{s.along_std:.3f}"),
        ("  distance to normal law", lambda s: f"{s.along_distance:.3f}"),
        ("displacement sideways, units", lambda s: f"{s.lateral_mean:.3f}"),
        ("  standard deviation", lambda s: f"{s.lateral_std:.3f}"),
        ("  distance to normal law", lambda s: f"{s.lateral_distance:.3f}"),
        ("falls per 1,000 subgoals", lambda s: f"{s.falls:.2f}"),
        ("  of those straight on", lambda s: _or_dash(s.falls_straight, ".2f")),
        ("  after a quarter turn", lambda s: _or_dash(s.falls_quarter, ".2f")),
        ("  after a half turn", lambda s: _or_dash(s.falls_half, ".2f")),
        ("  stood again, %", lambda s: _or_dash(100 * s.recovered, ".0f")),
        ("  after seconds", lambda s: _or_dash(s.recovery_seconds, ".1f")),
        ("breakdowns of the simulation", lambda s: f"{s.breakdowns:.2f}"),
    )

    body = [[name, *map(write, measured.values())] for name, write in rows]
    return on_terminal(Table("", [robot, *measured], body))


def of_drift(drift: Sequence[subgoals.Drift], robot: str) -> rich.table.Table:
    """Returns the table of a robot's drift from cell centres, for a `rich` console."""
    head = [robot, "subgoals", "robots", "off along, units", "off sideways", "in the right cell, %"]
    body = [
        [
            "anchored" if d.anchored else "not anchored",
            str(d.num_subgoals),
            str(d.num_robots),
            f"{d.along_mean:.2f} ± {d.along_std:.2f}",
            f"{d.lateral_mean:.2f} ± {d.lateral_std:.2f}",
            _or_dash(100 * d.in_cell, ".0f"),
        ]
        for d in drift
    ]
    return on_terminal(Table("in their cells, from the centre", head, body))


def of_standing(standing: standing_lib.Standing, robot: str) -> rich.table.Table:
    """Returns the table of how many fallen robots stand up again, for a `rich` console."""
    head = [robot, *(f"stand after {after}, %" for after in standing.shares)]
    shares = [_or_dash(100 * share, ".0f") for share in standing.shares.values()]
    title = "on the ground, number of subgoals since"
    return on_terminal(Table(title, head, [[f"{standing.num_down} lying", *shares]]))


def _or_dash(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
