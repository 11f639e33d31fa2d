"""Benchmark of the physics engines; ratios, never limits.

Times that are compared are taken in turns, and the shortest of each side counts: whatever else the
machine does can only lengthen them.
"""

import itertools
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import batch as mujoco_batch

from eihrl_jax import base, mazes, robots
from eihrl_jax.benchmarks import part, timing
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, scene, walls

_BATCHES, _CPU_BATCHES = (64, 1024, 8192), (16, 64, 256)
"""Ants at once."""


def interface_ratio(num_envs: int = 1024, num_steps: int = 20, repeats: int = 15) -> part.Figures:
    """Compares the batched C engine behind our interface with `mujoco.batch` alone.

    Both step the same ants, with the same controls, from the same states, all walls parked: ours
    inside `jit` and `scan`, the other in a Python loop that writes controls and steps.

    Args:
      num_envs: ants.
      num_steps: control steps per measurement.
      repeats: measurements of each side.

    Returns:
      `ours` and `alone`, control steps per second, and `ratio`, ours/alone.
    """
    engine = engines.make(robots.load("ant"), "mujoco")
    start = _standing(engine, jnp.zeros((num_envs, 2)))
    ctrls = _random_ctrls(engine, num_steps, num_envs)

    # Each ant has its own walls, though they are all alike, as it has in a maze.
    parked = jnp.broadcast_to(jnp.array(scene.PARKED_XY), (num_envs, engine.robot.num_walls, 2))
    step = jax.vmap(engine.step)
    ours = timing.rolled(lambda state, ctrl: step(state, ctrl, parked), start, ctrls)

    alone = mujoco_batch.Batch(engine.model, num_envs)
    # Bindings are views of the batch's own memory: writing to them is all that is needed.
    alone.bind("mocap_pos")[..., :2] = scene.PARKED_XY
    first_qpos, host_ctrls = np.asarray(start.qpos, np.float64), np.asarray(ctrls, np.float64)

    def run_alone() -> None:
        alone.bind("qpos")[:] = first_qpos
        # The solver's first guess too, or repeats would begin with another than the first.
        for name in ("qvel", "qacc_warmstart"):
            alone.bind(name)[:] = 0.0
        for ctrl in host_ctrls:
            alone.bind("ctrl")[:] = ctrl
            alone.step(nstep=engine.robot.num_substeps)

    times = timing.shortest({"ours": ours, "alone": run_alone}, repeats)
    rates = {name: num_envs * num_steps / seconds for name, seconds in times.items()}
    return rates | {"ratio": rates["ours"] / rates["alone"]}


def interface_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of the interface's cost."""
    measured = f"{100 * figures['ratio']:.0f} % of {figures['alone']:,.0f} control steps/s"
    return {"C engine behind the interface against `mujoco.batch` alone, 1024 ants": measured}


def maze_costs(num_steps: int = 10) -> dict[str, part.Figures]:
    """Compares the cost of a control step in the Spiral with that in the Random Square.

    Ants start where episodes start and push at random; finding the walls near them is included.

    Args:
      num_steps: control steps per measurement.

    Returns:
      For each engine `spiral` and `random`, microseconds per control step of one ant (on a CPU: of
      all its cores' time together), and `ratio`, spiral/random.
    """
    # Of the process, where cores are shared: other work on the machine doesn't count then.
    clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter

    costs = {}
    # A step of MJX takes fifty times as long on a processor.
    for name, num_envs, repeats in (("mujoco", 256, 15), ("mjx", 32, 12)):
        engine = engines.make(robots.load("ant"), name)
        runs = {
            maze: random_walk(engine, mazes.load(maze), num_steps, num_envs)
            for maze in ("spiral", "random")
        }
        times = timing.shortest(runs, repeats, clock)
        cost = {maze: 1e6 * seconds / (num_envs * num_steps) for maze, seconds in times.items()}
        costs[name] = cost | {"ratio": cost["spiral"] / cost["random"]}
    return costs


def maze_costs_rows(figures: dict[str, part.Figures]) -> part.Rows:
    """Returns the table's rows of a control step's cost in the larger maze."""
    return {
        f"cost of a control step, Spiral against Random Square, {engine}": (
            f"{100 * (cost['ratio'] - 1):+.1f} %"
        )
        for engine, cost in figures.items()
    }


def throughput(
    sizes: tuple[int, ...] | None = None, num_steps: int = 10, repeats: int = 3
) -> list[dict[str, str | float]]:
    """Measures both engines' rates by the number of ants that are stepped at once.

    Ants start where episodes of the Random Square start and push at random; finding the walls near
    them is included, learning isn't.

    Args:
      sizes: numbers of ants; None: what suits the processor or the accelerator.
      num_steps: control steps per measurement.
      repeats: measurements, of which the fastest counts.

    Returns:
      One row for each engine and number of ants: `engine`, `num_envs`, and `rate`, control steps of
      all ants together per second.
    """
    if sizes is None:
        sizes = _CPU_BATCHES if jax.default_backend() == "cpu" else _BATCHES

    rows, maze = [], mazes.load("random")
    for name, num_envs in itertools.product(base.ENGINES, sizes):
        engine = engines.make(robots.load("ant"), name)
        run = {name: random_walk(engine, maze, num_steps, num_envs)}
        seconds = timing.shortest(run, repeats)[name]
        rows.append({"engine": name, "num_envs": num_envs, "rate": num_envs * num_steps / seconds})
    return rows


def throughput_rows(figures: list[dict[str, str | float]]) -> part.Rows:
    """Returns the table's rows of the engines' rates."""
    return {
        f"{row['num_envs']:,} ants at once, {row['engine']}": f"{row['rate']:,.0f} control steps/s"
        for row in figures
    }


def engine_deviations(num_envs: int = 16, num_steps: int = 50) -> list[dict[str, str | float]]:
    """Compares MJX with the C engine: the same ants, the same controls, with and without walls.

    Comparisons: "one step", both engines make each control step from the states that the C engine
    had reached; "free run", each goes on from its own states; "C against itself", free runs of the
    C engine from starts that differ by a float32 rounding, which no float32 engine can undercut.

    Args:
      num_envs: ants in each surrounding, thrown into a corner where there are walls.
      num_steps: control steps.

    Returns:
      One row for each surrounding and comparison: `walls`, `comparison`, and of the greatest
      deviation of any position (units, radians) the `median`, 90th percentile `p90` and `max` over
      ants and steps; `torso`, the median deviation of the torso's xy at the last step, units.
    """
    robot = robots.load("ant")
    c_engine, mjx_engine = (engines.make(robot, name) for name in base.ENGINES)
    c_step, mjx_step = (jax.jit(jax.vmap(engine.step)) for engine in (c_engine, mjx_engine))

    # Ants in all sorts of postures, on their way into the corner.
    start = _standing(c_engine, jnp.zeros((num_envs, 2)))
    noise = 0.05 * jax.random.normal(jax.random.key(2), start.qpos.shape)
    start = start.replace(qpos=start.qpos + noise, qvel=start.qvel.at[:, :2].set(1.0))
    # One unit in the last place of float32.
    nudged = start.replace(qpos=start.qpos * (1 + 2.0**-23))
    ctrls = _random_ctrls(c_engine, num_steps, num_envs)

    rows = []
    for is_walled in (False, True):
        # A corner of three boxes, whose faces are 0.8 units from the ants' centres.
        boxes = [[2.3, -0.7], [-0.7, 2.3], [2.3, 2.3]] if is_walled else [scene.PARKED_XY] * 3
        boxes = jnp.tile(jnp.array(boxes), (num_envs, 1, 1))
        truth = _free_run(c_step, start, ctrls, boxes)
        # "One step" begins where the C engine was, so that errors don't add up.
        before = [start, *truth[:-1]]
        runs = {
            "one step": [mjx_step(*x, boxes) for x in zip(before, ctrls, strict=True)],
            "free run": _free_run(mjx_step, start, ctrls, boxes),
            "C against itself": _free_run(c_step, nudged, ctrls, boxes),
        }
        rows += [
            {"walls": is_walled, "comparison": name, **_deviation(run, truth)}
            for name, run in runs.items()
        ]
    return rows


def deviation_rows(figures: list[dict[str, str | float]]) -> part.Rows:
    """Returns the table's rows of MJX's deviation from MuJoCo C."""
    rows = {}
    for row in figures:
        where = "at walls" if row["walls"] else "on open floor"
        what = f"MJX against MuJoCo C, 50 control steps {where}, {row['comparison']}"
        rows[what] = ", ".join(f"{name} {row[name]:.0e}" for name in ("median", "p90", "max"))
    return rows


def _free_run(
    step: Callable[..., engine_lib.PhysicsState],
    state: engine_lib.PhysicsState,
    ctrls: jax.Array,
    boxes: jax.Array,
) -> list[engine_lib.PhysicsState]:
    """Returns the states [N] after each of the controls [T, N, nu]."""
    states = itertools.accumulate(ctrls, lambda s, u: step(s, u, boxes), initial=state)
    return list(states)[1:]


def _deviation(
    run: list[engine_lib.PhysicsState], truth: list[engine_lib.PhysicsState]
) -> part.Figures:
    """Summarises how far positions are apart, see `engine_deviations`."""
    apart = np.abs(
        [np.asarray(a.qpos) - np.asarray(b.qpos) for a, b in zip(run, truth, strict=True)]
    )

    greatest = apart.max(-1)  # over positions; [T, N]
    return {
        "median": float(np.median(greatest)),
        "p90": float(np.quantile(greatest, 0.9)),
        "max": float(greatest.max()),
        "torso": float(np.median(np.linalg.norm(apart[-1, :, :2], axis=-1))),
    }


def random_walk(
    engine: engine_lib.Engine, maze: mazes.Maze, num_steps: int, num_envs: int
) -> Callable[[], engine_lib.PhysicsState]:
    """Returns a function that lets ants push at random from where a maze's episodes start."""
    keys = jax.random.split(jax.random.key(0), num_envs)
    start = _standing(engine, jax.vmap(mazes.maze.draw_start, in_axes=(None, 0))(maze, keys))
    ctrls = _random_ctrls(engine, num_steps, num_envs)

    def step(state: engine_lib.PhysicsState, ctrl: jax.Array) -> engine_lib.PhysicsState:
        return engine.step(state, ctrl, walls.nearby(maze, state.qpos[:2], engine.robot.num_walls))

    return timing.rolled(jax.vmap(step), start, ctrls)


def _standing(engine: engine_lib.Engine, xy: jax.Array) -> engine_lib.PhysicsState:
    """Returns robots at rest in the keyframe `stand` at positions [N, 2]."""
    qpos = jnp.tile(jnp.asarray(engine.model.key_qpos[0], jnp.float32), (len(xy), 1))
    qvel = jnp.zeros((len(xy), engine.model.nv))
    return jax.vmap(engine_lib.reset)(qpos.at[:, :2].set(xy), qvel)


def _random_ctrls(engine: engine_lib.Engine, num_steps: int, num_envs: int) -> jax.Array:
    """Draws controls [T, N, nu], uniform in [-1, 1]."""
    shape = (num_steps, num_envs, engine.model.nu)
    return jax.random.uniform(jax.random.key(1), shape, minval=-1.0, maxval=1.0)
