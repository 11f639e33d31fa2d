"""What a hierarchy loses by imperfect movement, measured by Monte Carlo, and what bounds allow.

The value is the discounted success, gamma^(decisions - 1) where the goal was reached within the
time limit, averaged over starts: its gap is at most the greatest over states, which the bounds are
about. Episodes have the same random numbers under every noise level, so gaps are paired.
"""

import dataclasses
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import value_gap as gap_config
from eihrl_jax.envs import postures, subgoals
from eihrl_jax.evaluation import loading, metas, rollouts
from eihrl_jax.physics import engines
from eihrl_jax.runs import policies
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.theory import bounds, displacement

ORACLE_ROBOT = "ant"
"""Robot whose body and postures the oracle moves."""

Values: TypeAlias = dict[str, Float[np.ndarray, "2 _"]]
"""Success and discounted success of every episode, by maze."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gap:
    """One way of moving against the reference, in one maze.

    Attributes:
      maze: its label.
      movement: "oracle", or the name of the robot of the full hierarchy.
      sigma: standard deviation per axis of oracle movement, units; None: the full hierarchy.
      success: share of the episodes that reached the goal.
      success_gap: that of the reference minus it.
      success_margin: half the 95 % interval of `success_gap`.
      success_bound: what |success_gap| is at most, in theory.
      value_gap: discounted success of the reference minus that of this movement.
      value_margin: half the 95 % interval of `value_gap`.
      value_bound: what |value_gap| is at most, in theory.
      total_variation: of the displacement laws, per subgoal.
    """

    maze: str
    movement: str
    sigma: float | None
    success: float
    success_gap: float
    success_margin: float
    success_bound: float
    value_gap: float
    value_margin: float
    value_bound: float
    total_variation: float


def compare(options: gap_config.ValueGapConfig) -> list[Gap]:
    """Measures all gaps.

    Args:
      options: what is compared.

    Returns:
      The gaps, oracle movement first.

    Raises:
      base.UserError: a maze has several goals; a policy or maze is unknown.
    """
    # One goal: the value is a probability of reaching it, discounted by when.
    chosen = mazes.load_all(options.mazes)
    for name, maze in chosen.items():
        if int(maze.num_goals) != 1:
            raise base.UserError(f"mazes: {name!r} has {int(maze.num_goals)} goals, must have 1")
    high = loading.load_high(options.high)
    stacked = mazes.stack(list(chosen.values()))

    # Before the first episode, so that what can't be loaded is named at once.
    full = {name: _full_env(stacked, high, name) for name in options.robots}
    laws = {name: shipped_law(name) for name in options.robots}

    # The reference may be among the noise levels; it is run once.
    oracle: dict[float, Values] = {}
    for sigma in dict.fromkeys((options.reference, *options.sigmas)):
        env, title = _oracle_env(stacked, high, sigma), f"oracle, sigma {sigma:g}"
        oracle[sigma] = _values(options, env, high, chosen, options.episodes, title)
    reference, law = oracle[options.reference], _oracle_law(options.reference)

    gaps: list[Gap] = []
    for sigma in options.sigmas:
        # Without noise the law is a point, which no density comes near.
        delta = displacement.total_variation(_oracle_law(sigma), law) if sigma else 1.0
        gaps += _gaps(options, chosen, "oracle", sigma, reference, oracle[sigma], delta)

    # Fewer episodes than the oracle's, since each of them costs its physics.
    for name, env in full.items():
        title = f"{name}, walking"
        values = _values(options, env, high, chosen, options.full_episodes, title)
        delta = displacement.total_variation(laws[name], law)
        gaps += _gaps(options, chosen, name, None, reference, values, delta)
    return gaps


def shipped_law(robot: str) -> displacement.Displacement:
    """Returns the displacement law of a robot's shipped low level, as its training measured it.

    Raises:
      base.UserError: the robot has none.
    """
    # From the folder, where training wrote it: nothing is simulated for it.
    path = policies.find(robot, "low")
    _, meta = policies.load(path, kind="low", robot=robot)
    law = metas.read(policies.entry(meta, "statistics", path), metas.Law, path)
    return displacement.Displacement.of(*dataclasses.astuple(law))


def _oracle_law(sigma: float) -> displacement.Displacement:
    """Returns the displacement law of oracle movement; its density exists for a positive sigma."""
    return displacement.Displacement.of(base.CELL, max(sigma, 1e-12))


def _oracle_env(stacked: mazes.Maze, high: loading.HighLevel, sigma: float) -> rollouts.Recordable:
    """Returns oracle movement with one noise level."""
    robot = robots.load(ORACLE_ROBOT)
    gait = subgoals.Gait(base.CELL, sigma, postures.for_robot(robot))
    view = high.view_in(stacked)
    return loading.oracle_env(robot, stacked, view, gait=gait, anchored=high.anchors(robot))


def _full_env(stacked: mazes.Maze, high: loading.HighLevel, name: str) -> rollouts.Recordable:
    """Returns the full hierarchy with a robot's shipped low level."""
    robot = robots.load(name)
    engine = engines.make(robot, "mujoco")
    low_policy = loading.load_low(name, robot)
    view = high.view_in(stacked)
    return loading.full_env(engine, stacked, view, low_policy, anchored=high.anchors(robot))


def _values(
    options: gap_config.ValueGapConfig,
    env: rollouts.Recordable,
    high: loading.HighLevel,
    chosen: dict[str, mazes.Maze],
    num_episodes: int,
    title: str,
) -> Values:
    """Runs the episodes of one movement."""
    plan = rollouts.Plan(mazes=chosen, seeds=(options.seed,), num_episodes=num_episodes)
    with progress_lib.Progress(title, plan.num_decisions, unit="decisions") as progress:
        by_maze = rollouts.Runner(env, plan).run(high.policy, progress)

    values = {}
    for name, rollout in by_maze.items():
        success = (np.asarray(rollout.episodes.achieved) > 0).astype(float)
        # The reward comes at the end of the last decision, which is discounted d - 1 times.
        decisions = np.asarray(rollout.episodes.decisions)
        values[name] = np.stack([success, success * options.gamma ** (decisions - 1)])
    return values


def _gaps(
    options: gap_config.ValueGapConfig,
    chosen: dict[str, mazes.Maze],
    movement: str,
    sigma: float | None,
    reference: Values,
    values: Values,
    delta: float,
) -> list[Gap]:
    """Compares one movement with the reference in every maze."""
    gaps = []
    for name, maze in chosen.items():
        ours, theirs = values[name], reference[name]
        # The oracle's episodes are paired; those with physics draw other random numbers.
        if sigma is not None:
            variance = (theirs - ours).var(1) / ours.shape[1]
        else:
            variance = theirs.var(1) / theirs.shape[1] + ours.var(1) / ours.shape[1]

        # Rows are success and discounted success; 1.96 standard errors to either side are 95 %.
        success_gap, value_gap = map(float, theirs.mean(1) - ours.mean(1))
        success_margin, value_margin = map(float, 1.96 * np.sqrt(variance))

        # Undiscounted, each of the episode's decisions may go wrong; discounted, gamma weighs them.
        limit = int(maze.num_decisions)
        gaps.append(
            Gap(
                maze=name,
                movement=movement,
                sigma=sigma,
                success=float(ours[0].mean()),
                success_gap=success_gap,
                success_margin=success_margin,
                success_bound=float(displacement.success_gap_bound(delta, limit)),
                value_gap=value_gap,
                value_margin=value_margin,
                value_bound=float(bounds.value_gap_bound(delta, 1, options.gamma, value_span=1.0)),
                total_variation=delta,
            )
        )
    return gaps
