"""Wrapper for Brax's learners that draws a new maze, start and goal for every episode."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from brax import envs
from brax.envs.wrappers import training
from jaxtyping import Array

from eihrl_jax import base
from eihrl_jax.ops import batching


def wrap(
    env: envs.Env,
    episode_length: int = 1000,
    action_repeat: int = 1,
    randomization_fn: object = None,
) -> envs.Wrapper:
    """Wraps one of our environments as `wrap_env_fn` of Brax's learners.

    Brax's own wrapper goes back to the place where the first episode of a row began. With this one
    every episode has a maze, a start and a goal of its own, and the rows run the same episodes as
    `envs.wrappers.AutoReset` of the bare environment does. Where one ends, `info` tells

    - `truncation` and `time_out`: 1 where the time is up and nothing else has ended it, by
      `episode_length` or by the bare environment's own limit, whichever is first;
    - `final_obs`: what was last seen of it; `obs` is already of the next one.

    Args:
      env: a `MazeEnv` or `LocomotionEnv`.
      episode_length: most steps of an episode.
      action_repeat: control steps that an action lasts.
      randomization_fn: must be None: what differs from episode to episode here is data.

    Raises:
      base.UserError: there is a `randomization_fn`.
    """
    if randomization_fn is not None:
        raise base.UserError("randomization_fn: mazes are drawn at each reset, it must be None")
    batched = training.VmapWrapper(env)
    return _DrawAnew(training.EpisodeWrapper(batched, episode_length, action_repeat))


class _DrawAnew(envs.Wrapper):
    """Begins a new episode in the step that ends one, see `wrap`; B rows."""

    def reset(self, rng: Array) -> envs.State:
        """Draws an episode for each row, from raw keys [B, 2]."""
        state = self.env.reset(rng)
        state.info["final_obs"] = state.obs
        return state

    def step(self, state: envs.State, action: Array) -> envs.State:
        """Advances one step, and into the next episode where that ends one."""
        # Steps are counted by Brax's wrapper, which leaves it to this one to begin at 0.
        info = state.info | {"steps": jnp.where(state.done > 0.0, 0.0, state.info["steps"])}
        state = dataclasses.replace(state, info=info, done=jnp.zeros_like(state.done))
        state = self.env.step(state, action)

        # `done` of an episode that is cut is Brax's limit; the flag alone is ours.
        is_late = (state.info["truncation"] > 0.0) | (state.info["time_out"] > 0.0)
        is_ended = (state.done > 0.0) & (state.info["truncation"] == 0.0)
        late = (is_late & ~is_ended).astype(jnp.float32)
        is_over = is_late | is_ended

        stepped: Any = state.pipeline_state  # of ours, where Brax would have its physics
        begin = jax.vmap(
            lambda is_over, key, old: batching.where_needed(is_over, self._begin, key, old)
        )
        pipeline_state, obs = begin(is_over, stepped.key, (stepped, state.obs))
        done = is_over.astype(jnp.float32)
        told = {
            "truncation": late,
            "time_out": late,
            "episode_done": done,
            "final_obs": state.obs,
        }
        return dataclasses.replace(
            state, pipeline_state=pipeline_state, obs=obs, done=done, info=state.info | told
        )

    def _begin(self, key: Array) -> tuple[Any, Any]:
        """Draws a new episode; returns what of its state replaces the old one's."""
        fresh = self.unwrapped.reset(key)
        return fresh.pipeline_state, fresh.obs
