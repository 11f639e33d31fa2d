"""The parts of the report: for each the evaluations that it needs, and the tables and pictures."""

import dataclasses
import functools
import itertools
import pathlib
import re
from collections.abc import Callable, Sequence

from eihrl_jax import base
from eihrl_jax.config import changes
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import report as report_config
from eihrl_jax.drawing import curves, figures
from eihrl_jax.evaluation import paper, results, tables
from eihrl_jax.mazes import generators
from eihrl_jax.reporting import baseline_curves, cached_runs, comparison, page
from eihrl_jax.runs import policies
from eihrl_jax.storage import writing

TABLE1 = tuple(tables.TABLE1_MAZES)
TRAINED = ("u", "s", "spiral")
ROBOTS = ("ant", "point", "swimmer", "humanoid")
SLOW = ("swimmer", "humanoid")
PRESETS = {"best": "ours, best", "paper": "ours, as in the paper"}
"""Labels of the presets in tables."""

_CURVES = {
    "sparse": ("success", "success, %", 100.0),
    "dense": ("success", "success, %", 100.0),
    "dense, average": ("eval/reward", "reward per decision", 1.0),
}
"""What learning curves show: column of the metrics, label and scale of the axis."""

ROOM_SIDE = 9
"""Free rows and columns of a generated room, without its outer wall."""

Cells = tuple[results.Cell, ...]


@dataclasses.dataclass(frozen=True)
class Runs:
    """The high levels of a report, and their evaluations, which are cached in its folder.

    Attributes:
      options: of the report.
    """

    options: report_config.ReportConfig

    @property
    def folder(self) -> pathlib.Path:
        """The folder of the high levels, each called `<preset>-<maze>-<seed>`."""
        return self.options.policies or policies.PRETRAINED

    def highs(self, trained: str) -> tuple[str, ...]:
        """Lists the high levels, one per seed, of a training such as "best-random"."""
        return tuple(map(str, cached_runs.seeds_of(self.folder, trained)))

    def metrics(self, trained: str) -> list[pathlib.Path]:
        """Lists their files of metrics, in run folders or as shipped."""
        names = ("metrics.csv", "high_metrics.csv")
        folders = map(pathlib.Path, self.highs(trained))
        files = [folder / name for folder in folders for name in names]
        return [file for file in files if file.exists()]

    def evaluate(self, name: str, high: tuple[str, ...], **options: object) -> Cells:
        """Returns the results of an evaluation, which is run if it isn't cached.

        Args:
          name: of the evaluation's folder.
          high: the high levels; without any there are no results.
          **options: of `EvaluateConfig`, in place of the report's own.
        """
        if not high:
            return ()
        own = evaluate_config.EvaluateConfig(
            episodes=self.options.episodes,
            movement=self.options.movement,
            high=high,
            out=self.options.out / "evaluations" / name,
        )
        return cached_runs.evaluated(changes.apply(own, options))

    def higl(self, name: str, trained_in: str, mazes: tuple[str, ...]) -> Cells:
        """Returns the results of HIGL, see `evaluate`; none unless full movement is evaluated."""
        if "full" not in self.options.movement:
            return ()
        highs = self.highs(f"higl-{trained_in}")
        return self.evaluate(name, highs, mazes=mazes, movement=("full",))

    def picture(self, name: str, pattern: str, caption: str) -> list[page.Picture]:
        """Returns the first picture of an evaluation whose file name matches, if there is one."""
        paths = sorted((self.options.out / "evaluations" / name).glob(pattern))
        return [page.Picture(path, caption) for path in paths[:1]]


def own(runs: Runs) -> page.Section:
    """Section of the high levels and mazes that the user names."""
    cells = runs.evaluate("own", runs.options.high, mazes=runs.options.mazes)
    # Seeds of one training share a row.
    groups: dict[str, list[results.Cell]] = {}
    for cell in cells:
        groups.setdefault(re.sub(r"\d+$", "*", cell.agent.high), []).append(cell)
    evaluated = {
        name if len({cell.agent.high for cell in own}) > 1 else own[0].agent.high: own
        for name, own in groups.items()
    }
    rows = comparison.by_movement(evaluated)
    names = tuple(dict.fromkeys(cell.maze for cell in cells))
    return page.Section(
        title="Your own runs and mazes",
        tables=[
            comparison.success_by_maze("Success", rows, names),
            comparison.failures("How their episodes ended", rows),
        ]
        if rows
        else [],
        pictures=[
            *runs.picture("own", "*heatmaps.png", "Where the robot was."),
            *runs.picture("own", "*-ends.png", "Where episodes ended that failed."),
            *runs.picture("own", "*.gif", "The robot on its way."),
        ],
    )


def table1(runs: Runs) -> page.Section:
    """Section of Table 1: trained in the Random Square, evaluated in mazes never seen."""
    ours = {
        label: runs.evaluate(f"table1-{preset}", highs, mazes=TABLE1)
        for preset, label, highs in _trained_for_others(runs)
    }
    uniform = runs.evaluate("table1-random", (evaluate_config.UNIFORM,), mazes=TABLE1)
    higl = runs.higl("table1-higl", "random", TABLE1)
    rows = comparison.by_movement({**ours, paper.RAND_H: uniform, "HIGL": higl})

    published = [
        comparison.Row("paper, oracle", published=paper.TABLE1["oracle"]),
        comparison.Row("paper, walking", published=paper.TABLE1["full"]),
        comparison.Row("paper, HIGL", published=paper.HIGL_TABLE1),
    ]
    return page.Section(
        title="Zero-shot mazes (Table 1)",
        text="Trained in the Random Square with oracle movement, then evaluated unchanged in mazes "
        "never seen.",
        tables=[
            comparison.success_by_maze("Table 1", [*published, *rows], TABLE1),
            comparison.failures("How episodes of Table 1 ended", rows),
        ],
        pictures=[
            *runs.picture("table1-best", "*full*heatmaps.png", "Where the walking ant was."),
            *runs.picture("table1-higl", "*heatmaps.png", "Where it was with HIGL (Figure 7)."),
            *runs.picture("table1-best", "*.gif", "The ant on its way, preset best."),
        ],
    )


def trained(runs: Runs) -> page.Section:
    """Section of U, S and Spiral: trained in the maze itself, or in the Random Square."""
    # One evaluation per maze, since each has its own high levels.
    evaluated: dict[str, Sequence[results.Cell]] = {
        label: [
            cell
            for maze in TRAINED
            for cell in runs.evaluate(
                f"{maze}-{preset}", runs.highs(f"{preset}-{maze}"), mazes=(maze,)
            )
        ]
        for preset, label in PRESETS.items()
    }
    evaluated[f"{PRESETS['best']}, trained in the square"] = runs.evaluate(
        "trained-best-random", runs.highs("best-random"), mazes=TRAINED
    )
    rows = comparison.by_movement(evaluated)

    return page.Section(
        title="Trained in the maze itself",
        text="U, S and Spiral, with the time limits of the paper's Table 3, compared with the high "
        "level trained in the Random Square.",
        tables=[
            comparison.success_by_maze("U, S and Spiral", rows, TRAINED),
            comparison.failures("How their episodes ended", rows),
        ]
        if rows
        else [],
        pictures=[
            picture
            for maze in TRAINED
            for kind in ("*full*-heatmap.png", "*.gif")
            for picture in runs.picture(f"{maze}-best", kind, f"The walking ant, {maze}.")
        ],
    )


def table2(runs: Runs) -> page.Section:
    """Section of Table 2: trained in U with the ant's postures, evaluated with other robots."""
    evaluated: dict[str, Sequence[results.Cell]] = {
        label: [
            cell
            for movement, robot in itertools.product(runs.options.movement, ROBOTS)
            # One evaluation each, because swimmer and humanoid have fewer episodes.
            for cell in runs.evaluate(
                f"table2-{preset}-{robot}-{movement}",
                runs.highs(f"{preset}-u"),
                mazes=("u",),
                robot=(robot,),
                movement=(movement,),
                episodes=runs.options.slow_episodes
                if movement == "full" and robot in SLOW
                else runs.options.episodes,
            )
        ]
        for preset, label in PRESETS.items()
    }
    evaluated["HIGL"] = runs.higl("table2-higl", "u", ("u",))

    rows = [
        comparison.Row("paper, oracle", published=paper.TABLE2),
        comparison.Row("paper, HIGL", published=paper.HIGL_TABLE2),
        *comparison.by_movement(evaluated),
    ]
    return page.Section(
        title="Zero-shot robots (Table 2)",
        text="Trained in the U-shaped maze with the ant, then evaluated unchanged with other "
        "robots. A high level that sees the robot was trained with pictures of the ant; preset "
        "best doesn't see it. Swimmer and humanoid have "
        f"{runs.options.slow_episodes} episodes per high level.",
        tables=[comparison.success_by_robot("Table 2, Maze-U", rows, ROBOTS)],
        pictures=[
            picture
            for robot in ROBOTS
            for picture in runs.picture(f"table2-best-{robot}-full", "*.gif", f"The {robot} in U.")
        ],
    )


def more_time(runs: Runs) -> page.Section:
    """Section of Table 1 with twice the time limit, and of generated rooms never seen."""
    oracle = {"movement": ("oracle",), "animate": "none"}
    late, in_rooms = [], []
    for preset, label, highs in _trained_for_others(runs):
        cells = runs.evaluate(f"twice-{preset}", highs, mazes=TABLE1, num_decisions=48, **oracle)
        late.append(comparison.Row(label, cells))
        # One episode per room: further ones in the same room would add little information.
        once_each = {"mazes": _rooms(runs), "episodes": 1, "heatmaps": False}
        cells = runs.evaluate(f"rooms-{preset}", highs, **once_each, **oracle)
        in_rooms.append(comparison.Row(label, cells))

    title = (
        f"{runs.options.num_rooms} generated {ROOM_SIDE}x{ROOM_SIDE} rooms of unseen seeds, "
        "four times the shortest tour"
    )
    return page.Section(
        title="Twice the time, and generated rooms",
        text="Oracle movement. Episodes that succeed only within twice the limit had failed for "
        "lack of time.",
        tables=[
            comparison.success_by_maze("Within twice the limit", late, TABLE1),
            comparison.overall(title, in_rooms),
        ],
    )


def learning(runs: Runs) -> page.Section:
    """Section of learning curves with their range over seeds (paper, Figures 5 and 6)."""
    pictures = []
    for maze, (kind, (column, label, scale)) in itertools.product(
        ("random", *TRAINED), _CURVES.items()
    ):
        # Dense runs are drawn twice, with success and with their reward.
        reward = "-dense" if kind.startswith("dense") else ""
        metrics = {
            name: runs.metrics(f"{preset}-{maze}{reward}") for preset, name in PRESETS.items()
        }
        drawn = {
            name: [curves.read(path, "num_decisions", column) for path in files]
            for name, files in metrics.items()
            if files
        }

        # No picture of a maze in which no preset was trained.
        if drawn:
            runs.options.out.mkdir(parents=True, exist_ok=True)
            path = runs.options.out / f"learning-{maze}-{kind.replace(', ', '-')}.png"
            draw = functools.partial(
                *(curves.save_spread, path, drawn),
                x_label="decisions",
                y_label=label,
                y_scale=scale,
            )
            if figures.attempt(path, draw):
                caption = f"{maze}, {kind} reward: mean and range over seeds while training."
                pictures.append(page.Picture(path, caption))
    return page.Section(
        title="Learning (Figures 5 and 6)",
        text="With dense reward, every decision left after the last goal has reward 1.",
        pictures=pictures,
    )


def baselines(runs: Runs) -> page.Section:
    """Section of the baselines' learning curves beside ours."""
    return baseline_curves.section(runs.metrics, runs.options.baselines, runs.options.out)


def ablations(runs: Runs) -> page.Section:
    """Section of ablations, from folders that `ablate_high` has written.

    Raises:
      base.UserError: a folder holds no evaluations.
    """
    shown, pictures = [], []
    for folder in runs.options.ablations:
        files = sorted((folder / "evaluations").glob("*/eval.json"), key=_ablation_order)
        if not files:
            raise base.UserError(f"ablations = {folder} holds no evaluations/*/eval.json")

        evaluated = {_variant(file): results.load(file).cells for file in files}
        shown.append(comparison.of_variants(f"Ablations: {folder.name}", evaluated))
        if (picture := folder / "curves.png").exists():
            pictures.append(page.Picture(picture, f"Success while training, {folder.name}."))
    return page.Section(
        title="Ablations",
        text="Trained in the Random Square with one option of the preset changed, then evaluated "
        "as in Table 1, with the oracle's epsilon at 0.3 units whatever it was in training.",
        tables=shown,
        pictures=pictures,
    )


PARTS: dict[report_config.Part, Callable[[Runs], page.Section]] = {
    "own": own,
    "table1": table1,
    "trained": trained,
    "table2": table2,
    "more_time": more_time,
    "learning": learning,
    "baselines": baselines,
    "ablations": ablations,
}
"""Parts of the report by name, in their order on the page."""


def _trained_for_others(runs: Runs) -> list[tuple[str, str, tuple[str, ...]]]:
    """Lists preset, label and high levels of what was trained in the Random Square."""
    trained = [(preset, label, runs.highs(f"{preset}-random")) for preset, label in PRESETS.items()]
    return [(preset, label, highs) for preset, label, highs in trained if highs]


def _rooms(runs: Runs) -> tuple[str, ...]:
    """Generates rooms unless they exist already, and returns their files."""
    folder = runs.options.out / "rooms"
    folder.mkdir(parents=True, exist_ok=True)
    files = {seed: folder / f"room-{seed:05d}.txt" for seed in range(runs.options.num_rooms)}
    for seed, file in files.items():
        if not file.exists():
            writing.write_text(file, generators.random_room(seed, ROOM_SIDE, ROOM_SIDE))
    return tuple(map(str, files.values()))


def _ablation_order(path: pathlib.Path) -> tuple[int, str]:
    """Sorts the unchanged preset first, and high levels without learning last."""
    name = _variant(path)
    return {"preset": 0, paper.RAND_H: 2, evaluate_config.FRONTIER: 2}.get(name, 1), name


def _variant(path: pathlib.Path) -> str:
    """Returns the name that `ablate_high` gave the variant of an evaluation's file."""
    folder = path.parent.name
    return folder if folder == paper.RAND_H else folder.replace("-", " ")
