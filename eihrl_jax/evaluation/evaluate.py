"""Evaluates agents in mazes: loads them and runs the episodes; `reporting` writes and draws."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.envs import raster, subgoals
from eihrl_jax.evaluation import baselines, loading, results, rollouts
from eihrl_jax.physics import engines
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import progress as progress_lib

_NUM_RECORDED: dict[evaluate_config.Animate, int] = {"one": 12, "all": 12, "failed": 60, "none": 0}
"""Episodes per maze among which one is found for the animation; failures are rare."""


@dataclasses.dataclass(frozen=True)
class _Prepared:
    """An agent that is ready to run its episodes."""

    agent: results.Agent
    robot: robot_lib.Robot
    runner: rollouts.Runner
    high_policy: rollouts.HighPolicy


class _Needs(NamedTuple):
    """The environment that a high level needs."""

    view: raster.View
    anchored: bool

    @classmethod
    def of(
        cls,
        high: loading.HighLevel,
        robot: robot_lib.Robot,
        stacked: mazes.Maze,
        options: evaluate_config.EvaluateConfig,
    ) -> "_Needs":
        """Returns the needs in some mazes; subgoals may be asked for that are of the other kind."""
        anchored = high.anchors(robot) if options.anchored is None else options.anchored
        return cls(high.view_in(stacked), anchored)


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """All episodes of one agent.

    Attributes:
      agent: what was evaluated.
      robot: its robot.
      mazes: by name.
      rollouts: its episodes by maze.
      seconds: that they took, compiling left out.
      is_last: whether no other agent follows.
      ends_when_solved: whether an episode is over with its last goal, as with sparse reward.
    """

    agent: results.Agent
    robot: robot_lib.Robot
    mazes: dict[str, mazes.Maze]
    rollouts: dict[str, rollouts.Rollout]
    seconds: float
    is_last: bool
    ends_when_solved: bool = True

    def cells(self) -> list[results.Cell]:
        """Summarises the episodes maze by maze."""
        return [
            results.summarise(
                name,
                self.agent,
                rollout.episodes
                if self.ends_when_solved
                else rollout.episodes.replace(shortest=None),
                num_goals=int(self.mazes[name].num_goals),
                num_decisions=int(self.mazes[name].num_decisions),
            )
            for name, rollout in self.rollouts.items()
        ]


def run(
    options: evaluate_config.EvaluateConfig, preview: Callable[[Evaluated], None] | None = None
) -> Iterator[Evaluated]:
    """Runs all episodes, agent by agent; everything is loaded before the first one runs.

    Args:
      options: what is to be evaluated.
      preview: is given the recorded episodes of an agent that is animated, when these are over
        long before all are.

    Raises:
      base.UserError: a maze, robot or policy is unknown or doesn't fit; two agents would have the
        same name in the files.
    """
    # Everything that can be wrong is loaded first: no hour of episodes is lost to a typing error.
    chosen = mazes.load_all(
        options.mazes, num_decisions=options.num_decisions, options=options.reading
    )
    plan = rollouts.Plan(
        mazes=chosen,
        seeds=options.seeds,
        num_episodes=options.episodes,
        num_recorded=_NUM_RECORDED[options.animate],
        recorded=tuple(chosen)[:1] if options.animate == "one" else None,
    )
    prepared = _prepare(options, plan)
    agents, places = len(prepared), len(chosen)
    print(
        f"{agents} agent{'s' * (agents > 1)} in {places} maze{'s' * (places > 1)}: "
        f"{len(plan.rows):,} episodes of each agent, at most {plan.num_decisions:,} decisions"
    )

    for item in prepared:
        title = f"{item.agent.robot}, {item.agent.movement} movement, {item.agent.high}"
        evaluated = functools.partial(
            Evaluated,
            agent=item.agent,
            robot=item.robot,
            mazes=chosen,
            is_last=item is prepared[-1],
            ends_when_solved=options.reward == "sparse",
        )
        early = None
        if preview and (options.animate != "one" or item is prepared[-1]):
            early = functools.partial(_show_early, preview, evaluated)
        with progress_lib.Progress(title, plan.num_decisions, unit="decisions") as progress:
            by_maze = item.runner.run(item.high_policy, progress, early)
        yield evaluated(rollouts=by_maze, seconds=progress.seconds)


def _show_early(
    preview: Callable[[Evaluated], None],
    evaluated: Callable[..., Evaluated],
    by_maze: dict[str, rollouts.Rollout],
) -> None:
    """Hands on the episodes that are over."""
    preview(evaluated(rollouts=by_maze, seconds=0.0))


def _prepare(options: evaluate_config.EvaluateConfig, plan: rollouts.Plan) -> list[_Prepared]:
    """Loads all policies and builds all environments before anything runs."""
    stacked = mazes.stack(list(plan.mazes.values()))

    # A name may be a high level's or a whole baseline's, which no other level goes with.
    whole = [name for name in options.high if baselines.is_baseline(name)]
    if whole and "full" not in options.movement:
        raise base.UserError(f"{whole[0]} is a baseline, which walks: it needs --movement full")
    greedy = options.greedy if options.greedy or options.sampled else None
    highs = [
        loading.load_high(name, greedy=greedy, knows=options.knows)
        for name in options.high
        if name not in whole
    ]

    prepared = []
    for i, name in enumerate(options.robot):
        robot = robots.load(name)
        for movement in options.movement if highs else ():  # a baseline brings its own
            low = None
            if movement == "full":
                low = options.low[i] if options.low else name
            needs = [_Needs.of(high, robot, stacked, options) for high in highs]
            envs = _envs(options, robot, low, stacked, needs)
            # One runner for all high levels with equal needs: those alike share what it compiles.
            runners = {need: rollouts.Runner(env, plan) for need, env in envs.items()}
            for high, need in zip(highs, needs, strict=True):
                agent = results.Agent(robot=robot.name, movement=movement, high=high.label, low=low)
                prepared.append(_Prepared(agent, robot, runners[need], high.policy))
        prepared += [_prepare_baseline(options, robot, name, plan, stacked) for name in whole]
    _check_names([item.agent for item in prepared], list(plan.mazes))
    return prepared


def _prepare_baseline(
    options: evaluate_config.EvaluateConfig,
    robot: robot_lib.Robot,
    name: str,
    plan: rollouts.Plan,
    stacked: mazes.Maze,
) -> _Prepared:
    """Loads a baseline: both levels in one, which ignores what a high level chooses."""
    agent = results.Agent(robot=robot.name, movement="full", high=name, low=None)
    engine = engines.make(robot, options.engine)
    env = baselines.load(name, engine, stacked, reward=options.reward)
    # A runner asks a high level for a direction; what it answers isn't used.
    uniform = loading.load_high(evaluate_config.UNIFORM)
    return _Prepared(agent, robot, rollouts.Runner(env, plan), uniform.policy)


def _envs(
    options: evaluate_config.EvaluateConfig,
    robot: robot_lib.Robot,
    low: str | None,
    stacked: mazes.Maze,
    needs: Sequence[_Needs],
) -> dict[_Needs, rollouts.Recordable]:
    """Builds one environment for each kind of needs, which high levels with these share.

    Its robot is driven by the low level `low`, or moved by the oracle where that is None.
    """
    reward = options.reward
    if low is None:
        gait = subgoals.gait(robot, options.measured, options.step, options.sigma)
        make = functools.partial(loading.oracle_env, robot, stacked, gait=gait, reward=reward)
    else:
        engine = engines.make(robot, options.engine)
        low_policy = loading.load_low(low, robot, stand=options.stand)
        make = functools.partial(
            loading.full_env, engine, stacked, low_policy=low_policy, reward=reward
        )

    return {need: make(view=need.view, anchored=need.anchored) for need in dict.fromkeys(needs)}


def _check_names(agents: Sequence[results.Agent], names: Sequence[str]) -> None:
    """Checks that no two agents have the same file names.

    Raises:
      base.UserError: two agents, or two of them in two mazes, would have the same name in the
        files.
    """
    # Characters that paths can't hold are replaced, which may make different labels the same; and
    # so may where an agent's name ends and a maze's begins.
    taken: dict[str, results.Agent] = {}
    for agent in agents:
        for name in (agent.file_name, *(agent.file_name_in(maze) for maze in names)):
            other = taken.setdefault(name, agent)
            if other is not agent:
                raise base.UserError(
                    f"high: files of two agents would have the same name, {name}, of "
                    f"{agent.high!r} and {other.high!r}; evaluate them one by one"
                )
