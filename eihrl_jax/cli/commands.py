"""The table of commands; each imports its modules when it is called, so that listing is instant.

`eihrl <command>` and `python -m experiments.<command>` are the same.
"""

import difflib
import pathlib
import shlex
import sys
from collections.abc import Callable, Sequence

import eihrl_jax
from eihrl_jax.cli import output
from eihrl_jax.cli.command import Command

Make = Callable[[], Command]

EARLIER = {("", "--peers"): "--baselines", ("--parts", "peers"): "baselines"}
"""Spellings of earlier versions that are still understood."""


def _close(run: pathlib.Path, following: str) -> None:
    """Prints what a training run has written, and which command comes next."""
    print(f"written to {run}: policy, metrics.csv, learning_curve.png")
    print(f"next: eihrl {following}")


def train_high() -> Command:
    """Trains a high level with oracle movement."""
    from eihrl_jax.config import high as high_config
    from eihrl_jax.config import presets
    from eihrl_jax.reporting import trainers

    def main(options: high_config.HighConfig) -> None:
        trainers.train_high(options)
        maze = "" if options.task.num_rooms else f" --mazes {shlex.quote(options.task.maze)}"
        _close(options.run, f"evaluate --high {shlex.quote(str(options.run))}{maze}")

    return Command(main, high_config.HighConfig, presets.HIGH, uses_all_cores=True)


def train_low() -> Command:
    """Trains a low level."""
    from eihrl_jax.config import low as low_config
    from eihrl_jax.config import presets
    from eihrl_jax.reporting import trainers

    def main(options: low_config.LowConfig) -> None:
        trainers.train_low(options)
        words = ["measure-low", "--robot", options.robot, "--low", str(options.run)]
        _close(options.run, shlex.join(words))

    return Command(main, low_config.LowConfig, presets.LOW)


def train_baseline() -> Command:
    """Trains a baseline: flat DroQ, HIGL, HRAC, HIRO, HESS, or PPO or SAC of Brax."""
    from eihrl_jax.config import baselines as baselines_config
    from eihrl_jax.config import presets
    from eihrl_jax.reporting import trainers

    def main(options: baselines_config.BaselineConfig) -> None:
        trainers.train_baseline(options)
        words = ["--mazes", options.maze, "--robot", options.robot, "--high", str(options.run)]
        _close(options.run, shlex.join(["evaluate", "--movement", "full", *words]))

    return Command(
        main,
        baselines_config.BaselineConfig,
        presets.BASELINES,
        option="method",
    )


def evaluate() -> Command:
    """Evaluates policies in mazes: success with intervals, heatmaps, an animation."""
    import rich.console

    from eihrl_jax.config import evaluate as evaluate_config
    from eihrl_jax.evaluation import tables
    from eihrl_jax.reporting import evaluations

    def main(options: evaluate_config.EvaluateConfig) -> None:
        evaluation = evaluations.evaluate(options)
        tables.show(tables.terminal(evaluation.cells))
        rich.console.Console().print(tables.NOTE, style="dim")
        files = sorted(path.name for path in options.out.glob(f"*.{options.format}"))
        files += ["heatmaps"] if any(options.out.glob("*.png")) else []
        print(f"written to {options.out}: {', '.join(['tables.md', 'episodes.csv', *files])}")

    return Command(main, evaluate_config.EvaluateConfig)


def measure_low() -> Command:
    """Measures how accurately a low level follows subgoals, and records its postures."""
    from eihrl_jax.config import measure as measure_config
    from eihrl_jax.evaluation import tables
    from eihrl_jax.reporting import measurements

    def main(options: measure_config.MeasureConfig) -> None:
        measured = measurements.measure(options)
        of_subgoals = tables.of_subgoals(measured.statistics, options.robot)
        shown = [of_subgoals, tables.of_drift(measured.drift, options.robot)]
        if measured.standing is not None:
            shown.append(tables.of_standing(measured.standing, options.robot))
        tables.show(shown)
        print(f"written to {options.out}")

    return Command(main, measure_config.MeasureConfig)


def dataset() -> Command:
    """Writes episodes of a hierarchy as a Minari dataset."""
    from eihrl_jax import datasets
    from eihrl_jax.config import dataset as dataset_config

    def main(options: dataset_config.DatasetConfig) -> None:
        datasets.check_installed()
        from eihrl_jax.datasets import dataset as dataset_lib

        path = dataset_lib.write(options)
        print(f"written to {path}: {options.episodes:,} episodes")
        print(f"next: minari.load_dataset({dataset_lib.name_of(options)!r})")

    return Command(main, dataset_config.DatasetConfig)


def plot() -> Command:
    """Draws the learning curves of runs in one picture, with mean and range over seeds."""
    from eihrl_jax.config import runs as runs_config
    from eihrl_jax.reporting import run_comparison

    def main(options: runs_config.PlotConfig) -> None:
        print(f"written to {run_comparison.plot(options)}")

    return Command(main, runs_config.PlotConfig)


def compare() -> Command:
    """Compares runs: the options in which they differ, their last metrics and their durations."""
    from eihrl_jax.config import runs as runs_config
    from eihrl_jax.evaluation import tables
    from eihrl_jax.reporting import run_comparison

    def main(options: runs_config.CompareRunsConfig) -> None:
        tables.show(tables.on_terminal(table) for table in run_comparison.compare(options))
        print(f"their curves: eihrl plot {shlex.join(map(str, options.runs))}")

    return Command(main, runs_config.CompareRunsConfig)


def robot() -> Command:
    """Proposes a robot description for any MJCF file, and tries it out."""
    from eihrl_jax.config import robot as robot_config
    from eihrl_jax.reporting import robot_trials

    def main(options: robot_config.RobotConfig) -> None:
        trial = robot_trials.try_out(options)
        print(robot_trials.summary(trial))
        print(f"written to {options.out}")
        robot_trials.check(trial)

    return Command(main, robot_config.RobotConfig)


def report() -> Command:
    """Puts everything that the paper reports on one page."""
    from eihrl_jax.config import report as report_config
    from eihrl_jax.reporting import report as report_lib

    return Command(
        report_lib.main, report_config.ReportConfig, uses_all_cores=True, earlier=EARLIER
    )


def maze() -> Command:
    """Shows a maze in any known format as text and picture, and converts it to ours."""
    from eihrl_jax.config import maze as maze_config
    from eihrl_jax.reporting import maze_views

    def main(options: maze_config.MazeConfig) -> None:
        print(maze_views.show(options))

    return Command(main, maze_config.MazeConfig)


def gallery() -> Command:
    """Animates one robot in several mazes, side by side."""
    from eihrl_jax.config import gallery as gallery_config
    from eihrl_jax.reporting import gallery as gallery_lib

    def main(options: gallery_config.GalleryConfig) -> None:
        for maze, episode in zip(options.mazes, gallery_lib.draw(options), strict=True):
            print(f"{maze}: success {episode.success:.0%}, {episode.num_decisions} decisions")
        print(f"written to {options.out}")

    return Command(main, gallery_config.GalleryConfig)


def list_() -> Command:
    """Lists what is shipped: policies, robots, mazes and suites of mazes."""
    from eihrl_jax.config import catalogue as catalogue_config
    from eihrl_jax.evaluation import tables
    from eihrl_jax.reporting import catalogue

    def main(options: catalogue_config.ListConfig) -> None:
        tables.show(tables.on_terminal(table) for table in catalogue.listed(options))

    return Command(main, catalogue_config.ListConfig)


def demo() -> Command:
    """Trains a high level, then evaluates the whole hierarchy in four mazes."""
    from eihrl_jax.studies import demo as demo_lib

    return Command(demo_lib.main, demo_lib.DemoConfig, uses_all_cores=True)


def value_gap() -> Command:
    """Compares bounds on the hierarchy's loss of value with the measured loss."""
    from eihrl_jax.config import value_gap as gap_config
    from eihrl_jax.reporting import value_gaps

    def main(options: gap_config.ValueGapConfig) -> None:
        gaps = value_gaps.compare(options)
        print(value_gaps.markdown(gaps), end="")
        print(f"written to {options.out}")

    earlier = {("", "--walking-episodes"): "--full-episodes"}
    return Command(main, gap_config.ValueGapConfig, earlier=earlier)


def predict() -> Command:
    """Predicts success in mazes from where a robot's subgoals end, without physics."""
    from eihrl_jax.config import predict as predict_config
    from eihrl_jax.reporting import predictions

    return Command(predictions.main, predict_config.PredictConfig)


def benchmark() -> Command:
    """Measures speeds, and how far the two physics engines diverge."""
    from eihrl_jax.benchmarks import suite

    return Command(suite.main, suite.BenchmarkConfig, uses_all_cores=True, earlier=EARLIER)


def train_policies() -> Command:
    """Trains every shipped high level again."""
    from eihrl_jax.studies import train_policies as policies_lib

    return Command(policies_lib.main, policies_lib.PoliciesConfig, uses_all_cores=True)


def ablate_high() -> Command:
    """Trains and evaluates a high level with one option changed at a time."""
    from eihrl_jax.studies import ablate_high as ablation

    return Command(ablation.main, ablation.AblationConfig, uses_all_cores=True)


def ablate_low() -> Command:
    """Trains a low level with one option changed at a time."""
    from eihrl_jax.studies import ablate_low as ablation

    return Command(ablation.main, ablation.AblationConfig)


def compare_baselines() -> Command:
    """Trains ours and the baselines at equal budgets."""
    from eihrl_jax.studies import compare_baselines as comparison

    return Command(comparison.main, comparison.CompareConfig)


def small_maze() -> Command:
    """Trains the two-level baselines in a small maze, where each of them succeeds."""
    from eihrl_jax.studies import small_maze as small

    return Command(small.main, small.SmallConfig)


def reproduce_droq() -> Command:
    """Trains DroQ in the task of its published curves."""
    from eihrl_jax.studies import reproduce_droq as reproduction

    return Command(reproduction.main, reproduction.ReproduceConfig)


def reproduce_higl() -> Command:
    """Trains HIGL in the maze of its published curves."""
    from eihrl_jax.studies import reproduce_higl as reproduction

    return Command(reproduction.main, reproduction.ReproduceConfig)


def faults() -> Command:
    """Kills and disturbs runs, resumes them and compares the results bit for bit."""
    from eihrl_jax.studies import faults as faults_lib

    return Command(lambda options: faults_lib.main(options, main), faults_lib.FaultsConfig)


def soak() -> Command:
    """Trains, evaluates and steps environments for an hour, and watches memory."""
    from eihrl_jax.studies import soak as soak_lib

    return Command(soak_lib.main, soak_lib.SoakConfig)


COMMANDS: dict[str, Make] = {
    make.__name__.removesuffix("_"): make
    for make in (
        train_high,
        train_low,
        train_baseline,
        evaluate,
        measure_low,
        dataset,
        plot,
        compare,
        robot,
        report,
        maze,
        gallery,
        list_,
        demo,
        value_gap,
        predict,
        benchmark,
        train_policies,
        ablate_high,
        ablate_low,
        compare_baselines,
        small_maze,
        reproduce_droq,
        reproduce_higl,
        faults,
        soak,
    )
}
"""By name; `eihrl` writes a hyphen for an underscore."""


@output.outlives_its_reader
def run(name: str) -> None:
    """Runs a command with the arguments of this process, as `python -m experiments.<name>`."""
    _run(name, sys.argv[1:], f"python -m experiments.{name}")


@output.outlives_its_reader
def main(argv: Sequence[str] | None = None) -> None:
    """Runs `eihrl <command> [options]`, or lists the commands."""
    # Parsed by hand: all options but these two belong to the commands, see `shell`.
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        print(_list())
        return
    if words[0] == "--version":
        print(f"eihrl_jax {eihrl_jax.__version__}")
        return

    name = words[0].replace("-", "_")  # either spelling will do
    if name not in COMMANDS:
        print(f"error: {_unknown(words[0])}", file=sys.stderr)
        sys.exit(2)  # as `shell.fail` does, whose import takes a second
    _run(name, words[1:], f"eihrl {_spelled(name)}")


def _run(name: str, arguments: list[str], program: str) -> None:
    """Runs a command; see `shell.run`."""
    from eihrl_jax.cli import shell  # With it come JAX and tyro, which a list does without.

    shell.run(COMMANDS[name](), arguments, program)


def _list() -> str:
    """Returns what `eihrl --help` prints."""
    width = max(map(len, COMMANDS)) + 2
    rows = [
        f"  {_spelled(name):{width}}{(make.__doc__ or '').splitlines()[0]}"
        for name, make in COMMANDS.items()
    ]
    usage = "usage: eihrl COMMAND [options]     (eihrl COMMAND --help shows the options)"
    return "\n".join([usage, "", "commands:", *rows])


def _unknown(word: str) -> str:
    """Returns the error for a word that is no command."""
    names = [_spelled(name) for name in COMMANDS]
    # One suggestion if a name is close, else all there are.
    near = difflib.get_close_matches(word, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"choose one of {', '.join(names)}"
    return f"{word!r} is not a command; {hint}"


def _spelled(name: str) -> str:
    return name.replace("_", "-")
