"""After the end of an episode: start a new one, or stay at rest."""

import dataclasses
from collections.abc import Callable
from typing import Generic

import jax.numpy as jnp
from jaxtyping import Array, Key

from eihrl_jax import base
from eihrl_jax.base import InnerT, ObsT
from eihrl_jax.ops import batching, tree


def rest_if_over(
    state: base.EnvState[InnerT, ObsT], following: base.EnvState[InnerT, ObsT]
) -> base.EnvState[InnerT, ObsT]:
    """Returns `following`; for an episode that is over, `state` again with reward 0.

    Args:
      state: before a step.
      following: what the step made of it.
    """
    rested = state.replace(reward=jnp.zeros_like(state.reward))
    return tree.where(state.is_over, rested, following)


@dataclasses.dataclass(frozen=True)
class AutoReset(Generic[InnerT, ObsT]):
    """Begins a new episode, drawn anew, right after one has ended.

    In the step that ends an episode `reward`, `terminated`, `truncated`, `metrics` and `final_obs`
    are those of the ended episode; `obs`, `inner` and `key` belong to the new one.

    Attributes:
      env: the environment.
      observe: draws the observation of an inner state. Where it is given and nobody looks at
        `final_obs`, one observation is drawn per step instead of two.
    """

    env: base.Environment[InnerT, ObsT]
    observe: Callable[[InnerT], ObsT] | None = None

    def reset(self, key: Key[Array, ""]) -> base.EnvState[InnerT, ObsT]:
        """Draws a new episode; the key is consumed."""
        return self.env.reset(key)

    def step(
        self, state: base.EnvState[InnerT, ObsT], action: Array
    ) -> base.EnvState[InnerT, ObsT]:
        """Advances one step, and into the next episode where that ends one."""
        # The flags may still be those of the episode before; the one in `inner` goes on.
        no = jnp.zeros_like(state.terminated)
        stepped = self.env.step(state.replace(terminated=no, truncated=no), action)

        # Few episodes of a batch end in the same step, and a reset may cost more than a step.
        inner, key, obs = batching.where_needed(
            stepped.is_over,
            self._begin,
            stepped.key,
            (stepped.inner, stepped.key, self._drawn(stepped.obs)),
        )
        # Drawn of the episode that goes on, once.
        obs = obs if self.observe is None else self.observe(inner)
        return stepped.replace(inner=inner, obs=obs, key=key)

    def _begin(self, key: Key[Array, ""]) -> tuple[InnerT, Key[Array, ""], ObsT | None]:
        """Draws a new episode; returns what of its state replaces the old one's."""
        fresh = self.env.reset(key)
        return fresh.inner, fresh.key, self._drawn(fresh.obs)

    def _drawn(self, obs: ObsT) -> ObsT | None:
        """Returns an observation, or none where `observe` draws it in the end."""
        return obs if self.observe is None else None
