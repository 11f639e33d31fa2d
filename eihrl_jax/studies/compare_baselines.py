"""Trains ours and the baselines at equal budgets: `python -m experiments.compare_baselines`."""

import dataclasses
import functools
import itertools
import pathlib
from collections.abc import Callable
from typing import Annotated

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import baselines as baselines_config
from eihrl_jax.config import changes, limits, presets
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import high as high_config
from eihrl_jax.envs import hierarchy
from eihrl_jax.evaluation import loading
from eihrl_jax.physics import engines
from eihrl_jax.reporting import cached_runs
from eihrl_jax.training import baselines, high

METHODS = ("ours", "rand_h", *presets.BASELINES)
"""Our high level; uniform directions in its place, both with the shipped low level; baselines."""

# Of our high level, whose preset has 512 workers and would make few updates.
_WORKERS = 4
_LOG_EVERY = 5
_EVALUATE_EVERY = 10
_EPISODES = 50
_SHORT = 300_000
"""Control steps up to which the methods' own schedules are shortened."""
_ROWS = 20
"""Rows of metrics that HESS's runs have, where an episode of all robots isn't longer than that."""
_UNIFORM_EPISODES = 500
"""RAND-H learns nothing: it is measured once, so as precisely as can be had."""

_HIGL: dict[str, object] = {"adjacency.period": 20_000, "landmarks.first_step": 20_000}

_SHORTENED: dict[str, dict[str, object]] = {
    "droq": {
        # One update of the actor and the temperature per control step, as the preset and the
        # released code have it: the period counts critic updates.
        "learner.actor_period": 1,
        "updates_per_step": 1,
        "capacity": 200_000,
        "evaluate_every": _EVALUATE_EVERY,  # Rows of 1,000 steps, a fifth of HIGL's.
    },
    "higl": _HIGL,
    "hrac": _HIGL,
    "hiro": _HIGL,
    "hess": {
        "num_envs": 2,  # So that there are rounds enough where an episode is long.
        "random_steps": 30_000,
        "capacity": 200,
        "representation.every": 20_000,
        "representation.num_updates": 10_000,
        "exploration.first_step": 20_000,
        "exploration.potential_step": 50_000,
    },
    # Both as they are: Brax's schedules don't look at the budget.
    "ppo": {},
    "sac": {},
}
"""What is changed of a method's preset for budgets of some 100,000 control steps."""

_Method = Annotated[str, limits.OneOf(METHODS)]
_Maze = Annotated[str, limits.OneOf(mazes.NAMES)]


@limits.dataclass
class CompareConfig:
    """Trains each method in each maze for the same number of control steps (Figures 5 and 6).

    Runs that the folder already holds are continued or taken as they are;
    `python -m experiments.report --baselines FOLDER` draws them. Settings are the methods' own, but
    for budgets of up to 300,000 schedules are shortened, see docs/baselines.md. Ours learns
    moved by the oracle, a decision counting as the control steps that it takes to walk it, and is
    evaluated both so and walking; RAND-H learns nothing.

    Attributes:
      methods: ours, rand_h, and those of `train_baseline`.
      mazes: names of mazes.
      rewards: of the tasks.
      seeds: of the runs of each method in each task.
      num_steps: control steps of each run, all environments together.
      out: folder of the runs, named `<method>-<maze>[-dense]-<seed>`.
    """

    methods: limits.Several[_Method] = ("ours", "rand_h", "droq", "higl", "hess")
    mazes: limits.Several[_Maze] = cached_runs.MAZES
    rewards: limits.Several[base.Reward] = base.REWARDS
    seeds: limits.Seeds = (0, 1, 2)
    num_steps: Annotated[int, limits.Range(1, 10_000_000)] = 100_000
    out: pathlib.Path = pathlib.Path("runs/baselines")


@dataclasses.dataclass(frozen=True)
class Run:
    """One run of the comparison: a method in a task with a seed."""

    method: str
    maze: str
    reward: base.Reward
    seed: int

    def folder(self, config: CompareConfig) -> pathlib.Path:
        """Returns where it is found."""
        return config.out / cached_runs.name(self.method, self.maze, self.reward, self.seed)


def main(config: CompareConfig) -> None:
    """Trains what is missing, seed by seed, so that all methods advance together."""
    tasks = itertools.product(config.seeds, config.rewards, config.mazes, config.methods)
    runs = [Run(method, maze, reward, seed) for seed, reward, maze, method in tasks]
    # Options are made, and so checked, before the first run begins.
    cached_runs.share([_checked(config, run) for run in runs])


def _checked(config: CompareConfig, run: Run) -> Callable[[], object]:
    """Returns the function that makes a run, unless it is there.

    Raises:
      base.UserError: it has been made with other options, or is damaged.
    """
    if run.method == "rand_h":
        return functools.partial(cached_runs.evaluated, uniform_options(config, run))
    if run.method == "ours":
        return cached_runs.checked(high_options(config, run), _train_ours)
    return cached_runs.checked(baseline_options(config, run), baselines.train)


def high_options(config: CompareConfig, run: Run) -> high_config.HighConfig:
    """Returns the options of a run of ours: few workers, so that there are updates enough."""
    preset = presets.HIGH["best"]
    assert preset.learner.window is not None

    # A decision costs the control steps in which the robot would walk it.
    steps_per_decision = robots.load(preset.task.robot).steps_per_subgoal
    per_update = _WORKERS * preset.learner.window * steps_per_decision
    rows = max(1, config.num_steps // (per_update * _LOG_EVERY))

    return changes.apply(
        preset,
        {
            "task.maze": run.maze,
            "task.reward": run.reward,
            "learner.num_workers": _WORKERS,
            "learner.num_updates": rows * _LOG_EVERY,
            "log_every": _LOG_EVERY,
            "evaluate_every": _EVALUATE_EVERY,
            "checkpoint_every": _EVALUATE_EVERY,
            "num_eval_episodes": _EPISODES,
            "num_devices": 1,
            "seed": run.seed,
            "run": run.folder(config),
            "resume": True,
        },
    )


def uniform_options(config: CompareConfig, run: Run) -> evaluate_config.EvaluateConfig:
    """Returns the options of RAND-H's evaluation."""
    return evaluate_config.EvaluateConfig(
        mazes=(run.maze,),
        movement=("full",),
        high=(evaluate_config.UNIFORM,),
        reward=run.reward,
        episodes=_UNIFORM_EPISODES,
        seeds=(run.seed,),
        animate="none",
        heatmaps=False,
        out=run.folder(config),
    )


def baseline_options(config: CompareConfig, run: Run) -> baselines_config.BaselineConfig:
    """Returns the options of a run of `train_baseline`."""
    options = presets.BASELINES[run.method]
    # In so short a run the presets' own schedules would begin late.
    if config.num_steps <= _SHORT:
        options = changes.apply(options, _SHORTENED[run.method])
    if isinstance(options, hess_config.HessConfig):
        options = _in_rows(options, config, run)
    return dataclasses.replace(
        options,
        maze=run.maze,
        reward=run.reward,
        seed=run.seed,
        num_steps=config.num_steps,
        run=run.folder(config),
        resume=True,
    )


def _train_ours(options: high_config.HighConfig) -> None:
    """Trains a run of ours, evaluated with physics too."""
    high.train(options, with_physics=_with_physics(options))


def _with_physics(options: high_config.HighConfig) -> hierarchy.Hierarchy:
    """Returns the same task with physics: the robot walks, driven by its shipped low level."""
    task, robot = options.task, robots.load(options.task.robot)
    # Mazes and view are those of the training's own evaluation, whatever its options are.
    oracle = high.in_use(high.make_env(task, options.seed), options)
    low_policy = loading.load_low(task.robot, robot)
    engine = engines.make(robot, "mujoco")  # The comparison is made on processors.
    return loading.full_env(
        engine,
        oracle.table.mazes,
        oracle.view,
        low_policy,
        anchored=task.anchored,
        reward=task.reward,
    )


def _in_rows(
    options: hess_config.HessConfig, config: CompareConfig, run: Run
) -> hess_config.HessConfig:
    """Returns HESS's options with rows of metrics that suit the budget.

    Raises:
      base.UserError: a round, an episode of all robots, is more than a tenth of the budget.
    """
    steps = int(mazes.load(run.maze).num_decisions) * robots.load(options.robot).steps_per_subgoal
    # Whole episodes of all robots, in whole periods.
    per_round = options.num_envs * options.period * options.num_periods(steps)
    if 10 * per_round > config.num_steps:
        raise base.UserError(
            f"num_steps = {config.num_steps} must be at least {10 * per_round} for hess in "
            f"{run.maze}, which learns in rounds of {per_round}"
        )
    log_rounds = max(1, config.num_steps // (_ROWS * per_round))
    return dataclasses.replace(options, log_rounds=log_rounds, checkpoint_every=1)
