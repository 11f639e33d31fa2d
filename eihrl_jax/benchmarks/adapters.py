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


def adapter_costs(
    robot: str = "point", num_envs: int = 256, num_steps: int = 20, repeats: int = 5
) -> part.Figures:
    """Compares the mazes of Gymnasium and Brax with the bare environment, all begun anew at ends.

    Gymnasium's is stepped from Python, as it must be, and so is the bare one that it is compared
    with: one compiled step at a time, its observation, reward and flags taken to NumPy. Brax's is
    compared with the bare one inside one compiled program each. Taken in turns; the processor times
    of the fastest count, which other work on the machine changes least.

    Args:
      robot: which robot, in the maze U; the point costs least by itself.
      num_envs: robots at once.
      num_steps: control steps of each per measurement.
      repeats: measurements of each.

    Returns:
      `gymnasium` and `brax`, how many times the bare environment's time a step takes.

    Raises:
      base.UserError: Gymnasium or Brax isn't installed.
    """
    try:
        from eihrl_jax import brax, gym
    except ImportError as error:
        raise base.UserError(f"part adapters: {error}") from None

    env = brax.MazeEnv("u", robot)
    shape = (num_steps, num_envs, env.action_size)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    bare = wrappers.AutoReset(env.bare)
    state = jax.jit(jax.vmap(bare.reset))(jax.vmap(jax.random.key)(jnp.arange(num_envs)))

    wrapped = brax.wrap(env, env.episode_steps)
    raw = jax.jit(jax.vmap(jax.random.PRNGKey))(jnp.arange(num_envs))
    envs = gym.MazeVectorEnv(num_envs, "u", robot, autoreset_mode="SameStep")
    envs.reset(seed=0)

    def step_gymnasium() -> None:
        for action in actions:
            envs.step(action)

    ctrls = jnp.asarray(actions)
    times = timing.shortest(
        {
            "stepped": _stepped(bare, state, actions),
            "gymnasium": step_gymnasium,
            "compiled": timing.rolled(jax.vmap(bare.step), state, ctrls),
            "brax": timing.rolled(wrapped.step, jax.jit(wrapped.reset)(raw), ctrls),
        },
        repeats,
        clock=time.process_time,
    )
    return {
        "gymnasium": times["gymnasium"] / times["stepped"],
        "brax": times["brax"] / times["compiled"],
    }


def adapter_rows(figures: part.Figures) -> part.Rows:
    """Returns the table's rows of the adapters' costs."""
    return {
        f"a step of 256 points through {name}, against the bare environment": (
            f"{figures[name.lower()]:.2f} times its processor time"
        )
        for name in ("Gymnasium", "Brax")
    }


def _stepped(
    env: wrappers.AutoReset, state: goal_maze.EnvState, actions: Float[np.ndarray, "T N nu"]
) -> Callable[[], None]:
    """Returns a function that steps the bare environment from Python."""

    @jax.jit
    def step(state: goal_maze.EnvState, action: Array) -> tuple[goal_maze.EnvState, Any]:
        state = jax.vmap(env.step)(state, action)
        return state, (state.obs, state.reward, state.terminated, state.truncated)

    def run() -> None:
        following = state
        for action in actions:
            following, seen = step(following, action)
            jax.device_get(seen)

    return run
