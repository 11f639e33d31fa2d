"""Policy and value of the high level from a map, by planning on it (Tamar et al. 2016).

Two numbers are learned per cell from the cell and the four around it, what it is worth and what it
lets through (a wall nothing), and value iteration carries them to the robot: a direction is worth
what the cell there is. No weight knows where on the map it is used, where the robot is, or which
way it looks: a corner of a wall means the same wherever it stands, also in a maze that training
never showed.
"""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from eihrl_jax.ops import planning

_OPEN = 3.0
"""Logit of the first gates: 0.95, so that values travel far before anything is learned."""

_FAINT = 0.03
"""Scale of the last layer's first weights: nothing but curiosity drives the first policy. Ten times
as much, and one seed of five stood still for most of its training."""


class PlanningActorCritic(nn.Module):
    """Logits of the subgoals from the values of the four cells around the robot, and a value.

    The value is learned by a dense layer over the values of all cells: it serves training alone and
    may know the maze that is trained in.

    Attributes:
      num_iterations: cells that values travel.
      cell_features: width of the hidden layer that looks at a cell and those around it.
      value_features: width of the hidden layer before the value.
      around: what is looked at beside a cell: "nothing", the four cells at its "sides", or also
        those at its "corners".
      optimism: first worth of a cell that hasn't been seen: the robot looks around before anything
        is learned, where chance would seldom take it to a goal that is far away.
    """

    num_iterations: int = 24
    cell_features: int = 8
    value_features: int = 32
    around: str = "sides"
    optimism: float = 1.0

    @nn.compact
    def __call__(self, chart: Bool[Array, "n n 4"]) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the four subgoals and the value of a map, see `raster.draw_map`.

        Source: Tamar et al. 2016, Sec. 4; gates per cell instead of shared transitions, and
          features that look the same after turning and mirroring, are ours.
        """
        # The robot is always in the middle, and nothing may hang on that: telling the cells around
        # it from others, a planner stayed at 66 % where it reaches 98 without.
        wall, goal, _, unseen = jnp.moveaxis(chart, -1, 0).astype(jnp.float32)
        grid = jnp.stack([wall, goal, unseen])
        features = look_around(grid, self.around)
        trunk_init = nn.initializers.orthogonal(2**0.5)
        hidden = nn.Dense(self.cell_features, kernel_init=trunk_init)(jnp.moveaxis(features, 0, -1))
        outputs = nn.Dense(2, kernel_init=nn.initializers.orthogonal(_FAINT))(nn.relu(hidden))
        # That there is no way through a wall is known: a room without inner walls doesn't teach it.
        is_open = 1.0 - wall
        optimism = self.param("optimism", nn.initializers.constant(self.optimism), ())
        reward = is_open * (outputs[..., 0] + optimism * unseen)
        gate = is_open * nn.sigmoid(outputs[..., 1] + _OPEN)
        values = planning.value_iteration(reward, gate, self.num_iterations)
        log_scale = self.param("log_scale", nn.initializers.constant(1.5), ())
        middle = chart.shape[0] // 2
        logits = jnp.stack([around[middle, middle] for around in planning.neighbours(values)])
        seen = nn.relu(nn.Dense(self.value_features)(values.ravel()))
        # A first value of zero: without a reward no advantage, so nothing is unlearned by chance.
        value_init = nn.initializers.orthogonal(0.01)
        value = nn.Dense(1, kernel_init=value_init, name="value")(seen)
        return jnp.exp(log_scale) * logits, value[0]


def look_around(grid: Float[Array, "C n m"], around: str) -> Float[Array, "F n m"]:
    """Adds to each cell the sums over those at its sides, and at its corners, as `around` says."""
    east, west, north, south = planning.neighbours(grid)
    features = [grid]
    if around != "nothing":
        features.append(east + west + north + south)
    if around == "corners":
        _, _, above, below = planning.neighbours(east + west)
        features.append(above + below)
    return jnp.concatenate(features)
