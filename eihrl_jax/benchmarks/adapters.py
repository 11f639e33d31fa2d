"""Benchmark of the Gymnasium and Brax adapters: what they cost per step."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eihrl_jax import base
from eihrl_jax.benchmarks import part, timing
from eihrl_jax.envs import goal_maze, wrappers

_ROBOTS = ("point", "ant")
_NUM_ENVS = 256


def adapter_costs(num_steps: int = 20, repeats: int = 3) -> part.Figures:
    """Compares the mazes of Gymnasium and Brax with the bare environment, all begun anew at ends.

    Gymnasium's is stepped from Python, as it must be, and so is the bare one that it is compared
    with: one compiled step at a time, its observation, reward and flags taken to NumPy. Brax's is
    compared with the bare one inside one compiled program each. Taken in turns; the processor times
    of the fastest count, which other work on the machine changes least.

    Args:
      num_steps: control steps per measurement of 256 robots in the maze U.
      repeats: measurements of each.

    Returns:
      How many times the bare environment's time a step takes, by robot and door: "point gymnasium",
      "point brax", and so on. The point costs least by itself, the ant is the paper's.

    Raises:
      base.UserError: Gymnasium or Brax isn't installed.
    """
    figures = {}
    for robot in _ROBOTS:
        times = _times(robot, num_steps, repeats)
        figures[f"{robot} gymnasium"] = times["gymnasium"] / times["stepped"]
        figures[f"{robot} brax"] = times["brax"] / times["compiled"]
    return figures


def adapter_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of the adapters' costs."""
    return {
        f"a step of {_NUM_ENVS} {robot}s through {name}, against the bare environment": (
            f"{figures[f'{robot} {name.lower()}']:.2f} times its processor time"
        )
        for robot in _ROBOTS
        for name in ("Gymnasium", "Brax")
    }


def _times(robot: str, num_steps: int, repeats: int) -> dict[str, float]:
    """Returns the seconds of steps through each door, and of the bare ones beside them."""
    try:
        from eihrl_jax import brax, gym
    except ImportError as error:
        raise base.UserError(f"part adapters: {error}") from None

    env = brax.MazeEnv("u", robot)
    shape = (num_steps, _NUM_ENVS, env.action_size)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    bare = wrappers.AutoReset(env.bare)
    reset = jax.jit(lambda seeds: jax.vmap(bare.reset)(jax.vmap(jax.random.key)(seeds)))
    seeds = jnp.arange(_NUM_ENVS)

    wrapped = brax.wrap(env, env.episode_steps)
    raw = jax.jit(jax.vmap(jax.random.PRNGKey))(seeds)
    envs = gym.MazeVectorEnv(_NUM_ENVS, "u", robot, autoreset_mode="SameStep")

    def step_gymnasium() -> None:
        envs.reset(seed=0)
        for action in actions:
            envs.step(action)

    ctrls = jnp.asarray(actions)
    return timing.shortest(
        {
            "stepped": _stepped(bare, lambda: reset(seeds), actions),
            "gymnasium": step_gymnasium,
            "compiled": timing.rolled(jax.vmap(bare.step), reset(seeds), ctrls),
            "brax": timing.rolled(wrapped.step, jax.jit(wrapped.reset)(raw), ctrls),
        },
        repeats,
        clock=time.process_time,
    )


def _stepped(
    env: wrappers.AutoReset,
    reset: Callable[[], goal_maze.EnvState],
    actions: Float[np.ndarray, "T N nu"],
) -> Callable[[], None]:
    """Returns a function that begins the bare environment anew and steps it from Python."""

    @jax.jit
    def step(state: goal_maze.EnvState, action: Array) -> tuple[goal_maze.EnvState, Any]:
        state = jax.vmap(env.step)(state, action)
        return state, (state.obs, state.reward, state.terminated, state.truncated)

    def run() -> None:
        state = reset()
        for action in actions:
            state, seen = step(state, action)
            jax.device_get(seen)

    return run
