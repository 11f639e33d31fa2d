"""Folder of a prediction: figures, table, and a picture beside what was measured with physics."""

import dataclasses
import json
import pathlib

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import predict as predict_config
from eihrl_jax.drawing import figures, palette
from eihrl_jax.envs import end_points
from eihrl_jax.evaluation import loading, prediction, results, tables
from eihrl_jax.runs import folders, versions
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.storage import writing

CLOSE = 0.03
"""How far success may be from what was predicted and still count as close."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """One agent in one maze.

    Attributes:
      robot: that walks.
      high: label of its high level.
      anchored: whether its subgoals were.
      predicted: what is to be expected.
      walked: what it did with physics; None where nobody has looked.
    """

    robot: str
    high: str
    anchored: bool
    predicted: prediction.Prediction
    walked: results.Cell | None = None

    @property
    def is_close(self) -> bool:
        """Whether what was measured is within `CLOSE` of what was predicted."""
        return self.walked is not None and (
            abs(self.walked.success.rate - self.predicted.success) <= CLOSE
        )


@dataclasses.dataclass(frozen=True)
class _Agent:
    """A robot and its high level, in mazes that have their time limits, beside what walked."""

    robot: str
    high: str
    ends: pathlib.Path
    mazes: dict[str, mazes.Maze]
    walked: dict[str, results.Cell]


def main(options: predict_config.PredictConfig) -> None:
    """Predicts, and prints the table."""
    print(markdown(predict(options)), end="")
    print(f"written to {options.out}")


def predict(options: predict_config.PredictConfig) -> list[Row]:
    """Predicts what is asked for, and fills the folder.

    Args:
      options: which agents, in which mazes.

    Returns:
      Agent by agent, maze by maze.

    Raises:
      base.UserError: the folder isn't free; something is unknown, damaged, or doesn't fit.
    """
    with folders.reserved(options.out):
        rows = [row for agent in _agents(options) for row in _rows(options, agent)]
        described = [dataclasses.asdict(row) for row in rows]
        document = {"rows": described, "versions": versions.describe()}
        writing.write_text(options.out / "prediction.json", json.dumps(document, indent=2) + "\n")
        writing.write_text(options.out / "prediction.md", markdown(rows))
        if options.walked:
            path = options.out / "prediction.png"
            figures.attempt(path, lambda: draw(path, rows))
    return rows


def markdown(rows: list[Row]) -> str:
    """Returns a table, predicted figures beside measured ones."""
    header = ["robot", "high level", "maze", "success %", "walked", "decisions", "walked"]
    lines = []
    for row in rows:
        predicted, walked = row.predicted, row.walked
        lines.append(
            [
                *(row.robot, row.high, predicted.maze),
                f"{100 * predicted.success:.1f}",
                "" if walked is None else f"{100 * walked.success.rate:.1f}",
                f"{predicted.decisions:.1f}",
                "" if walked is None else f"{walked.decisions_mean:.1f}",
                f"{predicted.thinned:.3g}",
            ]
        )
    return tables.markdown_grid([*header, "thinned"], lines) + "\n"


def draw(path: pathlib.Path, rows: list[Row]) -> None:
    """Draws measured success and decisions over predicted ones, as PNG."""
    figure = figures.new(9.0, 4.4)
    panels = figure.subplots(1, 2)
    names = list(dict.fromkeys(row.robot for row in rows))
    whats = (("success, %", _success), ("decisions", _decisions))
    for axes, (what, point) in zip(panels, whats, strict=True):
        ends: list[float] = []
        for name in names:
            points = [
                point(row.predicted, row.walked)
                for row in rows
                if row.walked is not None and row.robot == name
            ]
            x, y, low, high = zip(*points, strict=True)
            ends += [*x, *y]
            colour = palette.CURVE[names.index(name) % len(palette.CURVE)]
            axes.errorbar(
                x, y, yerr=[low, high], fmt="o", ms=4, lw=0.8, alpha=0.8, color=colour, label=name
            )

        span = [min(ends), max(ends)]
        axes.plot(span, span, color=palette.MUTED, linewidth=1.0, zorder=0)
        if what == "decisions":
            axes.set(xscale="log", yscale="log")
        figures.label(axes, f"predicted {what}", f"walked {what}")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, labelcolor=palette.INK)
    figures.save(figure, path)


def _success(
    predicted: prediction.Prediction, walked: results.Cell
) -> tuple[float, float, float, float]:
    """Returns predicted and measured success, and how far down and up its interval goes; %."""
    rate = walked.success
    low, high = max(rate.rate - rate.low, 0.0), max(rate.high - rate.rate, 0.0)
    return 100.0 * predicted.success, 100.0 * rate.rate, 100.0 * low, 100.0 * high


def _decisions(
    predicted: prediction.Prediction, walked: results.Cell
) -> tuple[float, float, float, float]:
    """Returns the same of decisions, whose interval isn't known."""
    return predicted.decisions, walked.decisions_mean, 0.0, 0.0


def _agents(options: predict_config.PredictConfig) -> list[_Agent]:
    """Returns what is to be predicted."""
    if options.walked:
        return [agent for folder in options.walked for agent in _walked(options, folder)]
    chosen = mazes.load_all(options.mazes, num_decisions=options.num_decisions)
    ends = options.ends or [None] * len(options.robot)
    return [
        _Agent(robot, high, _ends(robot, folder), chosen, {})
        for robot, folder in zip(options.robot, ends, strict=True)
        for high in options.high
    ]


def _walked(options: predict_config.PredictConfig, folder: pathlib.Path) -> list[_Agent]:
    """Returns the hierarchies of an evaluation with full movement, with its mazes and limits."""
    measured = dict(zip(options.robot, options.ends, strict=True)) if options.ends else {}
    evaluation = results.load(folder / "eval.json")
    cells: dict[results.Agent, dict[str, results.Cell]] = {}
    for cell in evaluation.cells:
        if cell.agent.movement == "full" and cell.agent.low is not None:
            cells.setdefault(cell.agent, {})[cell.maze] = cell
    if not cells:
        raise base.UserError(
            f"walked = {folder} holds no results of a hierarchy with full movement"
        )

    agents = []
    for agent, by_maze in cells.items():
        chosen = {
            name: mazes.load(name, num_decisions=options.num_decisions or cell.num_decisions)
            for name, cell in by_maze.items()
        }
        ends = _ends(agent.robot, measured.get(agent.robot))
        agents.append(_Agent(agent.robot, agent.high, ends, chosen, by_maze))
    return agents


def _ends(robot: str, folder: pathlib.Path | None) -> pathlib.Path:
    """Returns the file of a robot's end points, those shipped where there is no folder."""
    if folder is not None:
        return folder / end_points.FILE
    shipped = end_points.shipped(robots.load(robot).name)
    if not shipped.exists():
        raise base.UserError(
            f"ends: no end points are shipped for robot {robot!r}; measure_low measures them"
        )
    return shipped


def _rows(options: predict_config.PredictConfig, agent: _Agent) -> list[Row]:
    """Predicts what one agent does in its mazes."""
    robot, high = robots.load(agent.robot), loading.load_high(agent.high)
    anchored = high.anchors(robot) if options.anchored is None else options.anchored
    predictor = prediction.Predictor(
        robot,
        high,
        agent.mazes,
        end_points.load(agent.ends, robot.name, anchored=anchored),
        anchored=anchored,
        num_states=options.num_states,
        seed=options.seed,
    )

    rows = []
    title = f"{agent.robot}, {agent.high}"
    with progress_lib.Progress(title, len(agent.mazes), unit="mazes") as progress:
        for number, name in enumerate(agent.mazes, 1):
            predicted = predictor.run(name)
            walked = agent.walked.get(name)
            rows.append(
                Row(
                    robot=agent.robot,
                    high=agent.high,
                    anchored=anchored,
                    predicted=predicted,
                    walked=walked,
                )
            )
            progress.update(number, {"success": predicted.success})
    return rows
