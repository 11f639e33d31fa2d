"""Measures how a low level follows random subgoals on open floor, in rooms and in corridors."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base, robots
from eihrl_jax.config import low as low_config
from eihrl_jax.config import measure as measure_config
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import hierarchy, locomotion, postures, rooms, subgoals, wrappers
from eihrl_jax.evaluation import falls, loading
from eihrl_jax.evaluation import standing as standing_lib
from eihrl_jax.evaluation import statistics as statistics_lib
from eihrl_jax.evaluation import steps as steps_lib
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import rotations, tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import progress as progress_lib

SUBGOALS_PER_EPISODE = 20  # long enough that a fall's recovery is seen in its episode
NUM_ROOMS = 256
_ROOM_SEED = 2**32
"""Added to the seed, so that rooms differ from those of any training, whose seeds are smaller."""

DRIFT_AFTER = (1, 10, 100)
"""Numbers of subgoals after which `subgoals.Drift` is measured."""

_DRIFT_SIZE = 2 * DRIFT_AFTER[-1] + 3
"""Side of the floor for it, cells: so large that no robot reaches the border."""

_KEPT = ("switched", "along", "lateral", "fell", "broke_down")
"""Metrics of `locomotion.Locomotion` that `steps_lib.Steps` holds."""

_DISPLACEMENT = (
    *("along_mean", "along_std", "lateral_mean", "lateral_std", "correlation"),
    *("along_distance", "lateral_distance"),
)
"""Fields of `subgoals.Statistics` about displacements."""


@dataclasses.dataclass(frozen=True)
class Measurement:
    """The measurements of one low level.

    Attributes:
      robot: whose it is.
      statistics: by surroundings, such as `subgoals.OPEN`.
      drift: without and with anchors, after each of `DRIFT_AFTER`.
      standing: how many stand up again; None for a robot that can't fall.
      steps: on open floor, on the host.
      corridors: those in corridors.
    """

    robot: robot_lib.Robot
    statistics: dict[str, subgoals.Statistics]
    drift: list[subgoals.Drift]
    standing: standing_lib.Standing | None
    steps: steps_lib.Steps
    corridors: steps_lib.Steps

    def postures(self, num: int) -> postures.PostureBank:
        """Returns postures of the upright robot, see `upright_postures`."""
        return postures.PostureBank(qpos=upright_postures(self.steps, self.robot, num))


def run(options: measure_config.MeasureConfig) -> Measurement:
    """Measures a low level on open floor, in random rooms and in corridors.

    Args:
      options: which low level, and how long.

    Raises:
      base.UserError: robot or policy is unknown or doesn't fit.
    """
    robot = robots.load(options.robot)
    policy = loading.load_low(options.low or options.robot, robot, stand=options.stand)

    # Open floor shows the gait alone; in rooms walls disturb it as in a maze.
    engine = engines.make(robot, options.engine)
    seed = _ROOM_SEED + options.seed
    floors = {
        subgoals.OPEN: rooms.open_floor(),
        subgoals.ROOMS: rooms.random_rooms(NUM_ROOMS, seed),
        subgoals.CORRIDORS: rooms.random_rooms(NUM_ROOMS, seed, corridor_share=1.0),
    }

    # Rounded up: every robot follows the same whole number of subgoals.
    k, num_envs = robot.steps_per_subgoal, options.num_envs
    num_steps = k * math.ceil(options.num_subgoals / num_envs)
    num_drifting = math.ceil(options.num_subgoals / DRIFT_AFTER[-1])

    measured: dict[str, steps_lib.Steps] = {}
    drift: list[subgoals.Drift] = []
    num_following = len(floors) * num_steps * num_envs
    num_all = num_following + 2 * (k * DRIFT_AFTER[-1] + 1) * num_drifting
    with progress_lib.Progress(f"{robot.name}, on its way", num_all) as bar:
        for index, (name, floor) in enumerate(floors.items()):
            env = _env(engine, floor, SUBGOALS_PER_EPISODE)
            key = _key(options, index)
            done = index * num_steps * num_envs
            measured[name] = _follow(env, policy, num_envs, num_steps, key, bar, done)

        # One long episode, so that the figures after 1, 10 and 100 subgoals are of the same robots.
        for anchored in (False, True):
            floor = rooms.open_floor(_DRIFT_SIZE)
            env = _env(engine, floor, DRIFT_AFTER[-1] + 1, anchored=anchored)
            key, length = _key(options, len(floors)), k * DRIFT_AFTER[-1] + 1
            done = num_following + anchored * length * num_drifting
            steps = _follow(env, policy, num_drifting, length, key, bar, done)
            drift += [drift_after(steps, num, robot, anchored=anchored) for num in DRIFT_AFTER]

    statistics = {name: summarise(steps, robot, options.sigma) for name, steps in measured.items()}
    key = _key(options, len(floors) + 1)
    standing = standing_lib.measure(engine, policy, options.num_subgoals // 10, key)
    kept = measured[subgoals.OPEN], measured[subgoals.CORRIDORS]
    return Measurement(robot, statistics, drift, standing, *kept)


def _env(
    engine: engine_lib.Engine, floor: rooms.Rooms, num_subgoals: int, *, anchored: bool = False
) -> locomotion.Locomotion:
    """Returns the task with episodes of `num_subgoals` subgoals."""
    return locomotion.Locomotion(
        engine,
        floor,
        reward_options=low_config.LowReward(),  # unused: nothing is learned here
        episode_steps=num_subgoals * engine.robot.steps_per_subgoal,
        ends_at_fall=False,  # so that recoveries can be counted
        anchored=anchored,
    )


def _key(options: measure_config.MeasureConfig, stream: int) -> Key[Array, ""]:
    """Returns the key of one measurement, which doesn't depend on what else is measured."""
    return jax.random.fold_in(jax.random.key(options.seed), stream)


def _follow(
    env: locomotion.Locomotion,
    policy: hierarchy.LowPolicy,
    num_envs: int,
    num_steps: int,
    key: Key[Array, ""],
    progress: progress_lib.Progress,
    done: int,
) -> steps_lib.Steps:
    """Lets robots follow random subgoals for `num_steps` steps; returns what they did, on the host.

    `progress` is told the control steps of all robots, `done` of which came before.
    """
    k = env.robot.steps_per_subgoal
    resetting = wrappers.AutoReset(env)
    reset_key, act_key = jax.random.split(key)

    def advance(
        carry: tuple[locomotion.EnvState, steps_lib.SubgoalStart], _: None
    ) -> tuple[tuple[locomotion.EnvState, steps_lib.SubgoalStart], steps_lib.Steps]:
        state, start = carry
        before = state.inner
        was_down = body_lib.is_fallen(before.physics.qpos, env.robot)
        now = steps_lib.SubgoalStart(is_upright=~was_down, is_clear=_is_clear(env, before))

        # The conditions at a subgoal's start are carried along until it ends, k steps later.
        start = tree.where(before.step % k == 0, now, start)

        after = resetting.step(state, policy(state.obs, act_key))
        steps = steps_lib.Steps(
            direction=before.direction,
            start=start,
            was_down=was_down,
            ended=after.is_over,
            qpos=before.physics.qpos,
            **{name: after.metrics[name] for name in _KEPT},
        )
        return (after, start), steps

    # One subgoal per call, so that the progress bar moves; the last one may be cut.
    reset = jax.jit(jax.vmap(resetting.reset), compiler_options=base.QUICK_COMPILE)
    follow = jax.jit(lambda carry: jax.lax.scan(jax.vmap(advance), carry, length=k))
    # Never read: an episode's first step begins a subgoal.
    nothing = jnp.zeros(num_envs, bool)
    start = steps_lib.SubgoalStart(is_upright=nothing, is_clear=nothing)
    carry = reset(jax.random.split(reset_key, num_envs)), start
    parts = []
    for first in range(0, num_steps, k):
        carry, steps = follow(carry)
        parts.append(jax.device_get(steps))
        progress.update(done + min(first + k, num_steps) * num_envs)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:num_steps], *parts)


def _is_clear(env: locomotion.Locomotion, state: locomotion.LocomotionState) -> Bool[Array, ""]:
    """Returns whether no wall is within reach on the way one cell ahead; true in corridors."""
    room, reach = env.room(state.room), env.robot.reach * env.robot.units_per_metre

    # A grid over the way and the robot's reach around it, finer than a wall is thick.
    ahead = jnp.linspace(-reach, base.CELL + reach, 5)
    aside = jnp.array([-reach, 0.0, reach])
    grid = jnp.stack(jnp.meshgrid(ahead, aside), -1).reshape(-1, 2)
    way = jax.vmap(rotations.to_world_frame, in_axes=(0, None))(grid, state.direction)
    is_wall = jax.vmap(maze_lib.is_wall, in_axes=(None, 0))
    is_clear = ~is_wall(room, state.physics.qpos[None, :2] + way).any()
    return is_clear | env.is_corridor(state.room)


def drift_after(
    steps: steps_lib.Steps, num_subgoals: int, robot: robot_lib.Robot, *, anchored: bool
) -> subgoals.Drift:
    """Computes how far robots are from their cells' centres after some subgoals.

    Args:
      steps: on the host, of one episode, more than `num_subgoals` subgoals long.
      num_subgoals: after how many.
      robot: whose they are.
      anchored: whether the subgoals were.

    Returns:
      The figures over the robots that haven't fallen, NaN if all have.
    """
    k = robot.steps_per_subgoal
    end = k * num_subgoals  # positions are those before a step
    direction = np.asarray(steps.direction)[:end:k]
    toward = np.array(base.DIRECTIONS_XY, np.float64)[direction]  # [S, N, 2]

    # First and last position in cells; the target cell is the first one plus all subgoals.
    xy = np.asarray(steps.qpos)[[0, end], :, :2].astype(np.float64) / base.CELL
    cell = np.floor(xy)
    is_in_cell = (cell[1] == cell[0] + toward.sum(0)).all(1)
    off = base.CELL * (xy[1] - cell[1] - 0.5)

    # In the frame of the last subgoal, whose left is a quarter turn further.
    last = toward[-1]
    along = (off * last).sum(1)
    lateral = (off * np.stack([-last[:, 1], last[:, 0]], 1)).sum(1)

    stood = ~np.asarray(steps.was_down)[: end + 1].any(0)
    values = [column[stood] for column in (along, lateral, is_in_cell)]
    along_mean, lateral_mean, in_cell = (float(x.mean()) if len(x) else math.nan for x in values)
    along_std, lateral_std = (float(x.std()) if len(x) else math.nan for x in values[:2])
    return subgoals.Drift(
        anchored=anchored,
        num_subgoals=num_subgoals,
        num_robots=int(stood.sum()),
        along_mean=along_mean,
        along_std=along_std,
        lateral_mean=lateral_mean,
        lateral_std=lateral_std,
        in_cell=in_cell,
    )


def summarise(steps: steps_lib.Steps, robot: robot_lib.Robot, sigma: float) -> subgoals.Statistics:
    """Computes the statistics of subgoals from recorded steps.

    Args:
      steps: on the host.
      robot: whose they are.
      sigma: standard deviation of the normal law to compare with, units.

    Returns:
      The statistics; displacements are NaN where no subgoal was completed clear and upright.
    """
    is_counted = steps_lib.counts(steps)
    along, lateral = np.asarray(steps.along)[is_counted], np.asarray(steps.lateral)[is_counted]

    # A subgoal during which the simulation becomes unstable begins, but never completes.
    completed = (steps.switched > 0) & steps.start.is_upright
    begun = ((steps.switched > 0) | (steps.broke_down > 0)) & steps.start.is_upright
    num_begun = max(int(begun.sum()), 1)

    # The median is over falls with a recovery, whose share is `recovered`. Rates are per 1,000.
    times = falls.recovery_times(steps, robot.steps_per_subgoal)
    finite = times[np.isfinite(times)]
    return subgoals.Statistics(
        num_subgoals=int(begun.sum()),
        blocked=float(1.0 - is_counted.sum() / max(completed.sum(), 1)),
        **_displacement(along, lateral, sigma),
        falls=1000.0 * float((steps.fell > 0).sum()) / num_begun,
        **{f"falls_{turn}": rate for turn, rate in falls.by_turn(steps).items()},
        recovered=float(np.isfinite(times).mean()) if len(times) else math.nan,
        recovery_seconds=float(np.median(finite)) * robot.control_step if len(finite) else math.nan,
        breakdowns=1000.0 * float(steps.broke_down.sum()) / num_begun,
    )


def _displacement(
    along: Float[np.ndarray, " S"], lateral: Float[np.ndarray, " S"], sigma: float
) -> dict[str, float]:
    """Returns the statistics in `_DISPLACEMENT`, NaN below two subgoals."""
    if len(along) < 2:
        return dict.fromkeys(_DISPLACEMENT, math.nan)
    with np.errstate(invalid="ignore"):  # NaN where one of the two never changes
        correlation = np.corrcoef(along, lateral)[0, 1]

    # To what the high level trains with: N(cell, sigma^2) along the subgoal, N(0, sigma^2) aside.
    distances = (
        statistics_lib.wasserstein(along - base.CELL, sigma),
        statistics_lib.wasserstein(lateral, sigma),
    )
    moments = along.mean(), along.std(), lateral.mean(), lateral.std()
    values = map(float, (*moments, correlation, *distances))
    return dict(zip(_DISPLACEMENT, values, strict=True))


def upright_postures(
    steps: steps_lib.Steps, robot: robot_lib.Robot, num: int
) -> Float[Array, "num nq"]:
    """Picks upright postures, spread evenly over time and robots.

    Args:
      steps: on the host.
      robot: whose they are.
      num: how many postures.

    Returns:
      Positions as in MuJoCo's qpos, with x = y = 0; none from the first subgoal.

    Raises:
      base.UserError: the robot was never upright.
    """
    # During the first subgoal the robot still starts from rest.
    qpos = np.asarray(steps.qpos)[robot.steps_per_subgoal :]
    upright = qpos[~np.asarray(steps.was_down)[robot.steps_per_subgoal :]]
    if not len(upright):
        raise base.UserError(f"robot {robot.name!r} was never upright, so it has no postures")

    # Spread over the whole record, since neighbouring steps show nearly the same posture.
    index = np.linspace(0, len(upright) - 1, num).astype(np.int64)
    return jnp.asarray(upright[index]).at[:, :2].set(0.0)
