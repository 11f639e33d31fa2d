"""Wrappers of environments."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Key

from eihrl_jax import base
from eihrl_jax.ops import tree


@dataclasses.dataclass(frozen=True)
class AutoReset:
    """Begins a new episode, drawn anew, right after one has ended.

    In the step that ends an episode `reward`, `terminated`, `truncated`, `metrics` and `final_obs`
    are those of the ended episode; `obs`, `inner` and `key` belong to the new one.

    Attributes:
      env: the environment.
      observe: draws the observation of an inner state. Where it is given and nobody looks at
        `final_obs`, one observation is drawn per step instead of two.
    """

    env: base.Environment
    observe: Callable[[Any], Any] | None = None

    def reset(self, key: Key[Array, ""]) -> base.EnvState:
        """Draws a new episode; the key is consumed."""
        return self.env.reset(key)

    def step(self, state: base.EnvState, action: Array) -> base.EnvState:
        """Advances one step, and into the next episode where that ends one."""
        # The flags may still be those of the episode before; the one in `inner` goes on.
        no = jnp.zeros_like(state.terminated)
        ended = self.env.step(state.replace(terminated=no, truncated=no), action)
        fresh = self.env.reset(ended.key)
        is_done = ended.terminated | ended.truncated
        inner, obs, key = tree.where(
            is_done,
            (fresh.inner, fresh.obs, fresh.key),
            (ended.inner, ended.obs, ended.key),
        )
        obs = obs if self.observe is None else self.observe(inner)
        return ended.replace(inner=inner, obs=obs, key=key)
