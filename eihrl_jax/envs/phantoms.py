"""Phantom walls: rectangles painted into what the high level sees while it learns.

A policy that learns in one room leans on every wall it ever saw there, and gets stuck where an
unknown wall says otherwise. If now and then a wall is in the picture that is not there, it learns
to follow what the rest of the picture says.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Key

from eihrl_jax import base, raster

_STREAM = 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhantomWalls:
    """Paints a wall that isn't there into some of an environment's observations.

    Goals and the robot stay visible. The size of the rectangle, one to two cells a side, and its
    place, anywhere in the view and over its edge, are drawn anew for every observation. Movement
    and reward know nothing of it. `final_obs` stays as it is.

    Attributes:
      env: its observations are patches, see `raster`; if it resets itself, it must be inside.
      view: extent and resolution of the patches.
      probability: of a rectangle in an observation.
    """

    env: base.Environment
    view: raster.View
    probability: float

    def reset(self, key: Key[Array, ""]) -> base.EnvState:
        """Draws a new episode; the key is consumed."""
        return self._paint(self.env.reset(key))

    def step(self, state: base.EnvState, action: Array) -> base.EnvState:
        """Advances one step."""
        return self._paint(self.env.step(state, action))

    def _paint(self, state: base.EnvState) -> base.EnvState:
        # The environment splits this key for its next step, and never folds anything into it.
        draws = jax.random.uniform(jax.random.fold_in(state.key, _STREAM), (5,))
        is_painted = (draws[0] < self.probability) & rectangle(draws[1:], self.view)
        wall, goal = state.obs[..., 0], state.obs[..., 1]
        return state.replace(obs=state.obs.at[..., 0].set(wall | (is_painted & ~goal)))


def rectangle(draws: Array, view: raster.View) -> Bool[Array, "P P"]:
    """Turns four uniform draws from [0, 1) into a rectangle: height, width, row, column."""
    cell = base.CELL / view.pitch
    size = cell * (1.0 + draws[:2])
    low = draws[2:] * (view.pixels + size) - size
    centres = jnp.arange(view.pixels, dtype=jnp.float32) + 0.5
    is_row, is_column = (
        (centres >= low[axis]) & (centres < low[axis] + size[axis]) for axis in (0, 1)
    )
    return is_row[:, None] & is_column[None]
