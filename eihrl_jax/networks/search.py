"""Policy and value of the high level from a map, by shortest ways to what is worth most on it.

Something is worth going for only where nothing has been seen yet, or where a goal waits. A goal on
the map comes first. How much the unseen is worth, counted in moves, is learned from the cell and
those around it, and from how far the unseen goes on behind it. Of all that is left, the robot goes
for what is worth most less the moves to get there.

So there are no traps and no horizon: with any weights, each move comes one nearer to something that
is new, and every goal that can be reached is reached (docs/planning.md). No weight knows where on
the map it is used, how large the map is, or which way it looks.
"""

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from eihrl_jax.ops import planning

_OPEN = 3.0
"""Logit of the first gates: 0.95, so that the unseen is worth more the farther it goes on."""

_FAINT = 0.03
"""Scale of the last layer's first weights: at first all that is unseen is worth the same."""

_LOG_BOUND = 10.0
"""Greatest size of a worth's logarithm, so that all worths are finite."""

_FARTHEST = 30.0
"""Moves beyond which the value doesn't tell distances apart."""


class SearchActorCritic(nn.Module):
    """Logits of the subgoals from the moves that each costs or saves, and a value.

    Attributes:
      num_moves: length of the longest way that is looked at, which training limits; None: any.
      look_ahead: cells into the unseen that count for what going there is worth.
      cell_features: width of the hidden layer that looks at a cell and those around it.
      value_features: width of the hidden layer before the value.
      around: what is looked at beside a cell: "nothing", the four cells at its "sides", or also
        those at its "corners".
    """

    num_moves: int | None = 24
    look_ahead: int = 8
    cell_features: int = 8
    value_features: int = 32
    around: str = "sides"

    @nn.compact
    def __call__(self, chart: Bool[Array, "n m 4"]) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the four subgoals and the value of a map, see `raster.draw_map`.

        Source: the worth of the unseen is value iteration (Tamar et al. 2016, Sec. 4); worths in
          moves, and ways to them, are ours.
        """
        wall, goal, robot, unseen = (chart[..., channel] for channel in range(4))
        hidden = self._cells(jnp.stack([wall, goal, unseen]).astype(jnp.float32))
        worth = self._worth(hidden, goal & ~wall, unseen)

        # Ways lead through what hasn't been seen, as if nothing were there.
        if self.num_moves is None:
            values = planning.search(worth, ~wall, robot)
        else:
            values = planning.reach(worth, ~wall, self.num_moves)
        around, best = self._around(values, wall, robot)

        # A move is a move near and far: the four differ by two moves at most, wherever the goal is.
        is_something_left = best > planning.NOWHERE / 2
        log_scale = self.param("log_scale", nn.initializers.constant(0.7), ())
        logits = jnp.where(is_something_left, jnp.exp(log_scale) * (around - best), 0.0)
        best = jnp.where(is_something_left, best, -_FARTHEST)
        return logits, self._value(chart, hidden, best)

    def _cells(self, grid: Float[Array, "C n m"]) -> Float[Array, "n m F"]:
        """Returns what the hidden layer makes of each cell and those around it."""
        features = jnp.moveaxis(_look_around(grid, self.around), 0, -1)
        init = nn.initializers.orthogonal(2**0.5)
        return nn.relu(nn.Dense(self.cell_features, kernel_init=init, name="cells")(features))

    def _worth(
        self,
        hidden: Float[Array, "n m F"],
        goal: Bool[Array, "n m"],
        unseen: Bool[Array, "n m"],
    ) -> Float[Array, "n m"]:
        """Returns what going to each cell is worth, in moves."""
        init = nn.initializers.orthogonal(_FAINT)
        outputs = nn.Dense(2, kernel_init=init, name="worths")(hidden)
        reward = jnp.exp(jnp.clip(outputs[..., 0], -_LOG_BOUND, _LOG_BOUND))

        # Values travel through the unseen alone: what is seen has no worth that could hold a robot.
        gate = jnp.where(unseen, nn.sigmoid(outputs[..., 1] + _OPEN), 0.0)
        sums = planning.value_iteration(jnp.where(unseen, reward, 0.0), gate, self.look_ahead)

        moves = self.param("moves_per_worth", nn.initializers.constant(4.0), ())
        logs = jnp.log(jnp.where(unseen, sums, 1.0))
        # That goals pay is known; that one on the map comes before all that is new is ours.
        return jnp.where(goal, planning.GOAL, jnp.where(unseen, moves * logs, planning.NOWHERE))

    def _around(
        self,
        values: Float[Array, "n m"],
        wall: Bool[Array, "n m"],
        robot: Bool[Array, "n m"],
    ) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the values of the four directions, and the best of the cells around the robot."""
        # A lookup: adding over the whole map takes as long as half of the search.
        around = planning.at_sides(values, robot)
        best = around.max()

        # One can come back through the robot's cell; who bumps into a wall stays in it.
        around = jnp.maximum(around, best - 2.0)
        return jnp.where(planning.at_sides(wall, robot), best - 1.0, around), best

    def _value(
        self,
        chart: Bool[Array, "n m 4"],
        hidden: Float[Array, "n m F"],
        best: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Returns the value, from means over the map and the way to what the robot goes for."""
        wall, goal, _, unseen = (chart[..., channel] for channel in range(4))
        near = jnp.where(best > planning.GOAL / 2.0, best - planning.GOAL, best)
        near = jnp.clip(near, -_FARTHEST, _FARTHEST)
        scalars = [
            near / _FARTHEST,
            jnp.exp(near / (_FARTHEST / 2.0)),
            goal.any().astype(jnp.float32),
            unseen.mean(dtype=jnp.float32),
            wall.mean(dtype=jnp.float32),
        ]
        # The policy's part is left to the policy's loss.
        pooled = jax.lax.stop_gradient(jnp.concatenate([hidden.mean((0, 1)), jnp.stack(scalars)]))
        seen = nn.relu(nn.Dense(self.value_features, name="pooled")(pooled))
        # A first value of zero: without a reward no advantage, so nothing is unlearned by chance.
        init = nn.initializers.orthogonal(0.01)
        return nn.Dense(1, kernel_init=init, name="value")(seen)[0]


def _look_around(grid: Float[Array, "C n m"], around: str) -> Float[Array, "F n m"]:
    """Adds to each cell the sums over those at its sides, and at its corners, as `around` says."""
    east, west, north, south = planning.neighbours(grid)
    features = [grid]
    if around != "nothing":
        features.append(east + west + north + south)
    if around == "corners":
        _, _, above, below = planning.neighbours(east + west)
        features.append(above + below)
    return jnp.concatenate(features)
