"""HRAC's adjacency network: places that are near in control steps get near embeddings.

Zhang et al. 2020, Generating adjacency-constrained subgoals in hierarchical reinforcement learning,
Sec. 4. Which places were adjacent on the robot's way is kept in a table of unit squares. Positions
are relative to the maze's centre, in units.
"""

import functools
from typing import cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation
from eihrl_jax.config import higl as config_lib
from eihrl_jax.networks import mlp

MAX_SQUARES = 2**15
"""Most unit squares of a maze: their table takes the square of it in bytes, 1 GiB."""


class AdjacencyState(struct.PyTreeNode):
    """What has been learned about distances. S: unit squares of the maze.

    Attributes:
      network: what embeds places.
      table: bool [S, S], squares between which the robot went in few steps; symmetric.
    """

    network: optimisation.TrainState
    table: Bool[Array, "S S"]


class AdjacencyNetwork:
    """The functions of the network and its table; holds no state."""

    def __init__(self, num_rows: int, num_columns: int, options: config_lib.Adjacency):
        """Builds network and optimiser.

        Args:
          num_rows: unit squares of the maze from north to south.
          num_columns: from west to east.
          options: sizes and numbers.

        Raises:
          base.UserError: there are more than `MAX_SQUARES` squares.
        """
        if num_rows * num_columns > MAX_SQUARES:
            raise base.UserError(
                f"adjacency: the maze has {num_rows} x {num_columns} unit squares, must be at most "
                f"{MAX_SQUARES}; HIRO needs none"
            )
        self.options = options
        self._shape = num_rows, num_columns
        self._network = mlp.Mlp(options.hidden, options.num_features)
        self._optimizer = optax.adam(options.learning_rate)

    def init(self, key: Key[Array, ""]) -> AdjacencyState:
        """Draws the parameters; nothing is adjacent yet."""
        params = self._network.init(key, jnp.zeros(2))["params"]
        size = self._shape[0] * self._shape[1]
        return AdjacencyState(
            network=optimisation.init(self._optimizer, params),
            table=jnp.zeros((size, size), bool),
        )

    def mark(
        self,
        state: AdjacencyState,
        path_xy: Float[Array, "T N 2"],
        is_valid: Bool[Array, "T N"],
        is_end: Bool[Array, "T N"],
    ) -> AdjacencyState:
        """Marks what is adjacent on the ways of N robots.

        Args:
          state: the table so far.
          path_xy: positions after T control steps in a row, units.
          is_valid: whether the robot was on its way then.
          is_end: whether its episode ended there; what follows is another way.
        """
        square = self._square(path_xy)
        # The end of an episode still belongs to the way that it ends.
        ends = is_end.astype(jnp.int32)
        way = jnp.cumsum(ends, axis=0) - ends

        table = state.table
        # From 0 steps on: a place is adjacent to itself, by which `fit` knows what was visited.
        for apart in range(min(self.options.steps, path_xy.shape[0] - 1) + 1):
            end = path_xy.shape[0] - apart
            both = is_valid[apart:] & is_valid[:end] & (way[apart:] == way[:end])
            # What isn't valid is written beyond the table, that is, nowhere.
            first = jnp.where(both, square[:end], table.shape[0])
            table = table.at[first, square[apart:]].set(True, mode="drop")
            second = jnp.where(both, square[apart:], table.shape[0])
            table = table.at[second, square[:end]].set(True, mode="drop")
        return state.replace(table=table)

    def fit(
        self, state: AdjacencyState, key: Key[Array, ""]
    ) -> tuple[AdjacencyState, Float[Array, ""]]:
        """Fits the network to the pairs of visited squares; returns the last loss too."""
        # A square has been visited where it is adjacent to itself.
        is_visited = jnp.diagonal(state.table)
        num = is_visited.sum(dtype=jnp.int32)
        squares = jnp.nonzero(is_visited, size=is_visited.shape[0], fill_value=0)[0]
        squares = squares.astype(jnp.int32)

        # As many updates as some epochs over all pairs have.
        pairs = num.astype(jnp.float32) ** 2 / 2.0
        wanted = self.options.epochs * pairs / self.options.batch_size
        num_updates = jnp.minimum(wanted, self.options.max_updates).astype(jnp.int32)

        def body(
            i: Int[Array, ""], carry: tuple[optimisation.TrainState, Float[Array, ""]]
        ) -> tuple[optimisation.TrainState, Float[Array, ""]]:
            draw = jax.random.fold_in(key, i)
            # Drawn with replacement, where the released code makes whole passes over all pairs.
            pair = squares[jax.random.randint(draw, (2, self.options.batch_size), 0, num)]
            is_near = state.table[pair[0], pair[1]]
            loss_fn = functools.partial(self._loss, pair_xy=self._centre(pair), is_near=is_near)
            return optimisation.minimise(self._optimizer, loss_fn, carry[0])

        network, loss = jax.lax.fori_loop(0, num_updates, body, (state.network, jnp.float32(0.0)))
        return state.replace(network=network), loss

    def excess(
        self, params: base.Params, from_xy: Float[Array, "B 2"], to_xy: Float[Array, "B 2"]
    ) -> Float[Array, " B"]:
        """Returns by how much embeddings are farther apart than those of adjacent places.

        The limit lies halfway between `near` and `far`, as in HRAC's released code.
        """
        limit = (self.options.near + self.options.far) / 2.0
        return jnp.maximum(self._distance(params, jnp.stack([from_xy, to_xy])) - limit, 0.0)

    def _loss(
        self, params: base.Params, pair_xy: Float[Array, "2 B 2"], is_near: Bool[Array, " B"]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Returns the contrastive loss of pairs of places, twice: to minimise, and as a metric."""
        distance = self._distance(params, pair_xy)
        # Zhang et al. 2020, Sec. 4: a pair on the right side of its margin is left alone.
        near = jnp.maximum(distance - self.options.near, 0.0)
        far = jnp.maximum(self.options.far - distance, 0.0)
        loss = jnp.where(is_near, near, far).mean()
        return loss, loss

    def _distance(self, params: base.Params, pair_xy: Float[Array, "2 B 2"]) -> Float[Array, " B"]:
        features = cast(Array, self._network.apply({"params": params}, pair_xy))
        # The square root has no slope at zero.
        return jnp.sqrt(jnp.square(features[0] - features[1]).sum(-1) + 1e-12)

    def _square(self, xy: Float[Array, "*T 2"]) -> Int[Array, "*T"]:
        """Returns the numbers of the unit squares that positions are in."""
        num_rows, num_columns = self._shape
        # Rows are counted from the north, to which y points.
        i = jnp.floor(0.5 * num_rows - xy[..., 1]).astype(jnp.int32)
        j = jnp.floor(0.5 * num_columns + xy[..., 0]).astype(jnp.int32)
        return jnp.clip(i, 0, num_rows - 1) * num_columns + jnp.clip(j, 0, num_columns - 1)

    def _centre(self, square: Int[Array, "*B"]) -> Float[Array, "*B 2"]:
        """Returns the centres of unit squares."""
        num_rows, num_columns = self._shape
        i, j = square // num_columns, square % num_columns
        x = j.astype(jnp.float32) + 0.5 - 0.5 * num_columns
        y = 0.5 * num_rows - i.astype(jnp.float32) - 0.5
        return jnp.stack([x, y], -1)
