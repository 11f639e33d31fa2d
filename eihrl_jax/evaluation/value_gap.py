"""What a hierarchy loses by imperfect movement, measured by Monte Carlo, and what bounds allow.

The value is the discounted success, gamma^(decisions - 1) where the goal was reached within the
time limit, averaged over starts: its gap is at most the greatest over states, which the bounds are
about. Episodes have the same random numbers under every noise level, so gaps are paired.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from eihrl_jax import base, mazes, robots
from eihrl_jax.config import value_gap as gap_config
from eihrl_jax.envs import postures, subgoals
from eihrl_jax.evaluation import loading, rollouts
from eihrl_jax.physics import engines
from eihrl_jax.runs import policies
from eihrl_jax.runs import progress as progress_lib
from eihrl_jax.theory import bounds, displacement

ORACLE_ROBOT = "ant"
"""Robot whose body and postures the oracle moves."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gap:
    """One way of moving against the reference, in one maze.

    Attributes:
      maze: its label.
      movement: "oracle", or the name of the robot that walks.
      sigma: standard deviation per axis of oracle movement, units; None: walking.
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
    chosen = {name: mazes.load(name) for name in options.mazes}
    for name, maze in chosen.items():
        if int(maze.num_goals) != 1:
            raise base.UserError(f"mazes: {name!r} has {int(maze.num_goals)} goals, must have 1")
    high = loading.load_high(options.high)
    stacked = mazes.stack(list(chosen.values()))
    walkers = {name: (_walking(stacked, high, name), shipped_law(name)) for name in options.robots}

    def move(sigma: float) -> dict[str, Float[np.ndarray, "2 E"]]:
        env = _oracle(stacked, high, sigma)
        return _values(options, env, high, chosen, options.episodes, f"oracle, sigma {sigma:g}")

    reference = _oracle_law(options.reference)
    baseline = move(options.reference)
    gaps: list[Gap] = []
    for sigma in options.sigmas:
        found = move(sigma)
        # Without noise the law is a point, which no density comes near.
        delta = displacement.total_variation(_oracle_law(sigma), reference) if sigma else 1.0
        gaps += _gaps(options, chosen, "oracle", sigma, baseline, found, delta)
    for name, (env, law) in walkers.items():
        title = f"{name}, walking"
        found = _values(options, env, high, chosen, options.full_episodes, title)
        delta = displacement.total_variation(law, reference)
        gaps += _gaps(options, chosen, name, None, baseline, found, delta)
    return gaps


def shipped_law(robot: str) -> displacement.Displacement:
    """Returns the displacement law of a robot's shipped low level, as its training measured it.

    Raises:
      base.UserError: the robot has none.
    """
    _, meta = policies.load(policies.find(robot, "low"), kind="low", robot=robot)
    found = meta["statistics"]
    return displacement.Displacement.of(
        found["along_mean"], found["along_std"], found["lateral_mean"], found["lateral_std"]
    )


def _oracle_law(sigma: float) -> displacement.Displacement:
    return displacement.Displacement.of(base.CELL, max(sigma, 1e-12))


def _oracle(stacked: mazes.Maze, high: loading.HighLevel, sigma: float) -> rollouts.Recordable:
    """Returns oracle movement with one noise level."""
    robot = robots.load(ORACLE_ROBOT)
    gait = subgoals.Gait(base.CELL, sigma, postures.for_robot(robot))
    return loading.oracle_env(robot, stacked, high.view, gait=gait)


def _walking(stacked: mazes.Maze, high: loading.HighLevel, name: str) -> rollouts.Recordable:
    """Returns a robot that walks with its shipped low level."""
    robot = robots.load(name)
    engine = engines.make(robot, "mujoco")
    return loading.full_env(engine, stacked, high.view, loading.load_low(name, robot))


def _values(
    options: gap_config.ValueGapConfig,
    env: rollouts.Recordable,
    high: loading.HighLevel,
    chosen: dict[str, mazes.Maze],
    num_episodes: int,
    title: str,
) -> dict[str, Float[np.ndarray, "2 E"]]:
    """Returns success and discounted success of every episode, by maze."""
    plan = rollouts.Plan(mazes=chosen, seeds=(options.seed,), num_episodes=num_episodes)
    with progress_lib.Progress(title, plan.num_decisions, unit="decisions") as progress:
        found = rollouts.Runner(env, plan).run(high.policy, progress)
    values = {}
    for name, rollout in found.items():
        success = (np.asarray(rollout.episodes.achieved) > 0).astype(float)
        decisions = np.asarray(rollout.episodes.decisions)
        values[name] = np.stack([success, success * options.gamma ** (decisions - 1)])
    return values


def _gaps(
    options: gap_config.ValueGapConfig,
    chosen: dict[str, mazes.Maze],
    movement: str,
    sigma: float | None,
    baseline: dict[str, Float[np.ndarray, "2 E"]],
    found: dict[str, Float[np.ndarray, "2 F"]],
    delta: float,
) -> list[Gap]:
    """Compares one movement with the reference in every maze; oracle episodes are paired."""
    gaps = []
    for name, values in found.items():
        means = baseline[name].mean(1) - values.mean(1)
        if sigma is not None:
            variance = (baseline[name] - values).var(1) / values.shape[1]
        else:
            variance = sum(each.var(1) / each.shape[1] for each in (baseline[name], values))
        margins = 1.96 * np.sqrt(variance)
        limit = int(chosen[name].num_decisions)
        gaps.append(
            Gap(
                maze=name,
                movement=movement,
                sigma=sigma,
                success=float(values[0].mean()),
                success_gap=float(means[0]),
                success_margin=float(margins[0]),
                success_bound=float(displacement.success_gap_bound(delta, limit)),
                value_gap=float(means[1]),
                value_margin=float(margins[1]),
                value_bound=float(bounds.value_gap_bound(delta, 1, options.gamma, value_span=1.0)),
                total_variation=delta,
            )
        )
    return gaps
