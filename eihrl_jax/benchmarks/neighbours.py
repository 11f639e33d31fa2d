"""Benchmark of neighbouring projects: their speed and ours, measured alternately in one run.

Control steps of an ant that pushes at random, of 256 at once where a project has batches. What is
not installed is reported as such.
"""

import importlib.util
import pathlib
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from eihrl_jax import base, mazes, robots
from eihrl_jax.benchmarks import low, part, physics, timing
from eihrl_jax.physics import engines

_NUM_ENVS, _UPDATES = 256, 200
_ANT_MAZE = pathlib.Path("jaxgcrl/envs/ant_maze.py")


class Run(NamedTuple):
    """Something whose speed is measured.

    Attributes:
      call: does it once.
      count: control steps, or updates, that a call makes.
    """

    call: Callable[[], PyTree]
    count: int


class Pair(NamedTuple):
    """Two speeds that are compared.

    Attributes:
      ours: name of our run.
      theirs: name of the neighbour's.
      make: prepares the neighbour's run.
      needs: what has to be there for it.
    """

    ours: str
    theirs: str
    make: Callable[[], Run]
    needs: str


Figures = list[dict[str, str | float]]
"""One row for each neighbour, see `compare`."""


def ratios(jaxgcrl: pathlib.Path | None = None, repeats: int = 5) -> Figures:
    """Compares physics and learner with those of other projects.

    Args:
      jaxgcrl: checkout of JaxGCRL, none of whose dependencies but Brax is needed; None: left out.
      repeats: measurements of each.

    Returns:
      See `compare`.

    Raises:
      base.UserError: the checkout isn't one.
    """
    if jaxgcrl is not None and not (jaxgcrl / _ANT_MAZE).is_file():
        raise base.UserError(f"jaxgcrl = {jaxgcrl} holds no {_ANT_MAZE}")

    ours = {
        "C engine, U": lambda: _ant("mujoco", "u", 20),
        "MJX, U": lambda: _ant("mjx", "u", 5),
        "MJX, hardest maze": lambda: _ant("mjx", "jaxgcrl-hardest", 5),
        "DroQ": lambda: Run(low.train_ours(_UPDATES), _UPDATES),
    }
    robotics, brax = "gymnasium-robotics", "brax"
    pairs = [
        Pair("C engine, U", "Gymnasium-Robotics, U", lambda: _robotics("UMaze"), robotics),
        Pair("C engine, U", "Gymnasium-Robotics, Large", lambda: _robotics("Large"), robotics),
        *(
            Pair("MJX, U", f"Brax ant without walls, {backend}", _brax(backend), brax)
            for backend in ("mjx", "spring")
        ),
        *(
            Pair(
                f"MJX, {name}",
                f"JaxGCRL, {name}, {backend}",
                _jaxgcrl(jaxgcrl, maze, backend),
                "a checkout, --jaxgcrl",
            )
            for name, maze in (("U", "u_maze"), ("hardest maze", "hardest_maze"))
            for backend in ("mjx", "spring")
        ),
        Pair("DroQ", "sbx", lambda: Run(low.train_sbx(_UPDATES), _UPDATES), "sbx-rl"),
    ]
    return compare(ours, pairs, repeats)


def compare(
    ours: Mapping[str, Callable[[], Run]],
    pairs: list[Pair],
    repeats: int,
    clock: Callable[[], float] | None = None,
) -> Figures:
    """Measures runs alternately.

    Args:
      ours: prepares our runs, by name; those that nobody is compared with aren't.
      pairs: who is compared.
      repeats: measurements of each.
      clock: seconds; None: of the process, in which other work on a processor doesn't count, and
        with an accelerator of the wall.

    Returns:
      One row for each neighbour: `ours` and `theirs`, what is compared; `our_rate` and `rate`, per
      second of the processor, and `ratio`, medians; `least` and `greatest` ratio of the repeats. Or
      `missing`, what isn't there.
    """
    if clock is None:
        clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter

    runs, missing = {}, {}
    for pair in pairs:
        try:
            runs[pair.theirs] = pair.make()
        except ImportError as error:
            missing[pair.theirs] = f"not installed ({pair.needs}): {error}"
    there = [pair for pair in pairs if pair.theirs in runs]
    runs |= {name: ours[name]() for name in dict.fromkeys(pair.ours for pair in there)}

    times = timing.in_turns({name: run.call for name, run in runs.items()}, repeats, clock)
    rates = {name: [runs[name].count / each for each in times[name]] for name in runs}
    return [
        {"ours": pair.ours, "theirs": pair.theirs, "missing": missing[pair.theirs]}
        if pair.theirs in missing
        else {
            "ours": pair.ours,
            "theirs": pair.theirs,
            **_ratio(rates[pair.ours], rates[pair.theirs]),
        }
        for pair in pairs
    ]


def rows(figures: Figures) -> part.Rows:
    """Returns the table's rows of the comparison."""
    told = {}
    for row in figures:
        what = f"{row['ours']} against {row['theirs']}"
        told[what] = (
            str(row.get("missing"))
            if "missing" in row
            else (
                f"{row['ratio']:.2f} times ({row['least']:.2f} to {row['greatest']:.2f}); "
                f"{row['our_rate']:,.0f} against {row['rate']:,.0f}/s"
            )
        )
    return told


def _ratio(ours: list[float], theirs: list[float]) -> part.Figures:
    """Returns medians of rates that were measured in turns, and the spread of their ratio."""
    each = [one / other for one, other in zip(ours, theirs, strict=True)]
    return {
        "our_rate": statistics.median(ours),
        "rate": statistics.median(theirs),
        "ratio": statistics.median(each),
        "least": min(each),
        "greatest": max(each),
    }


def _ant(engine: str, maze: str, num_steps: int) -> Run:
    """Prepares our ants, the walls near them being found anew at each step."""
    made = engines.make(robots.load("ant"), engine)
    call = physics.random_walk(made, mazes.load(maze), num_steps, _NUM_ENVS)
    return Run(call, num_steps * _NUM_ENVS)


def _robotics(maze: str, num_steps: int = 300) -> Run:
    """Prepares one ant of Gymnasium-Robotics, which begins anew when an episode is over."""
    import gymnasium  # pyright: ignore[reportMissingImports]
    import gymnasium_robotics  # pyright: ignore[reportMissingImports]

    gymnasium.register_envs(gymnasium_robotics)
    env = gymnasium.make(f"AntMaze_{maze}-v5")
    assert env.action_space.shape is not None
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (num_steps, *env.action_space.shape))
    env.reset(seed=0)

    def call() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return Run(call, num_steps)


def _brax(backend: str) -> Callable[[], Run]:
    """Returns what prepares Brax's ants, which have no walls around them."""

    def make() -> Run:
        from brax import envs  # pyright: ignore[reportMissingImports]

        return _rolled(envs.get_environment("ant", backend=backend))

    return make


def _jaxgcrl(checkout: pathlib.Path | None, maze: str, backend: str) -> Callable[[], Run]:
    """Returns what prepares the ants of a checkout of JaxGCRL."""

    def make() -> Run:
        if checkout is None:
            raise ImportError("none was given")
        # The file alone: the package asks for loggers and learners that a step doesn't need.
        spec = importlib.util.spec_from_file_location("jaxgcrl_ant_maze", checkout / _ANT_MAZE)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return _rolled(module.AntMaze(backend=backend, maze_layout_name=maze))

    return make


def _rolled(env: Any, num_steps: int = 5) -> Run:
    """Prepares ants of an environment of Brax."""
    keys = jax.random.split(jax.random.PRNGKey(0), _NUM_ENVS)
    shape = (num_steps, _NUM_ENVS, env.action_size)
    actions = jax.random.uniform(jax.random.key(1), shape, minval=-1.0, maxval=1.0)
    state = jax.jit(jax.vmap(env.reset))(keys)
    return Run(timing.rolled(jax.vmap(env.step), state, actions), num_steps * _NUM_ENVS)
