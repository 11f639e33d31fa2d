"""Policy and value of the high level from a map, by shortest paths to the most valuable cells.

Cells have a worth only where nothing has been seen yet, or where an unvisited goal is. A goal on
the map comes first. The worth of an unseen cell, counted in moves, is learned from the cell and its
neighbours, and from how far the unseen region extends beyond it. The robot heads for the cell whose
worth minus the moves to get there is greatest.

So there are neither traps nor a horizon: with any weights, each move brings the robot one move
nearer to something new, and every goal that can be reached is reached (docs/planning.md). Weights
are shared by all cells, and don't depend on position, map size or direction.

`encode` searches the whole map once, and finds the few cells that determine logits and value.
`predict` computes logits and value from those cells alone, and learning differentiates only that.
"""

import functools
from typing import NamedTuple, TypeAlias

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax.ops import planning

_OPEN = 3.0
"""Logit of the initial gates, 0.95: the farther the unseen extends, the more it is worth."""

_FAINT = 0.03
"""Scale of the last layer's initial weights: all unseen cells start with nearly equal worths."""

_LOG_BOUND = 10.0
"""Largest absolute value of a worth's logarithm, so that all worths are finite."""

_FARTHEST = 30.0
"""Moves at which the value's input is clipped."""

_DIGIT = 3  # bits of a code that hold 0 to 4 cells
_CHANNELS = 3  # wall, goal, unseen
_ROBOT = 1 << 27  # bit of a code beyond its digits

_CACHED = 2**15
"""Cells of all maps that a CPU encodes at once, so that the arrays fit into its cache."""

_SIZES = {"nothing": 1, "sides": 2, "corners": 3}

Layer: TypeAlias = tuple[Float[Array, "i o"], Float[Array, " o"]]
"""Kernel and bias."""


class Encoding(struct.PyTreeNode):
    """What logits and value depend on. K is `look_ahead`.

    Attributes:
      codes: int32 [4, K + 1], for each of the four neighbours of the robot's cell, the best cell to
        reach through it, followed by the K cells beyond it that add to its worth; see `_codes`.
      moves: float32 [4], from each neighbour to its best cell.
      wall: bool [4], whether each neighbour is a wall.
      means: float32 [F], the hidden layer's features, averaged over the map's cells.
      shares: float32 [3], 1 if there is a goal, and the shares of cells that are unseen and wall.
    """

    codes: Int[Array, "4 k *b"]
    moves: Float[Array, "4 *b"]
    wall: Bool[Array, "4 *b"]
    means: Float[Array, "F *b"]
    shares: Float[Array, "3 *b"]


class SearchActorCritic(nn.Module):
    """Logits of the subgoals from the moves that each costs or saves, and a value.

    Attributes:
      num_moves: length of the longest path that is searched, which bounds the cost of training;
        None: any.
      look_ahead: how many cells into the unseen add to a cell's worth.
      cell_features: width of the hidden layer applied to each cell.
      value_features: width of the hidden layer before the value.
      around: inputs of that layer besides the cell: "nothing", the four neighbours at its "sides",
        or also those at its "corners".
    """

    num_moves: int | None = 24
    look_ahead: int = 8
    cell_features: int = 8
    value_features: int = 32
    around: str = "sides"

    def setup(self) -> None:
        """Defines the layers and parameters."""
        num_inputs = _CHANNELS * _SIZES[self.around]
        self.cells = _Dense(num_inputs, self.cell_features, 2**0.5)
        self.worths = _Dense(self.cell_features, 2, _FAINT)
        self.moves_per_worth = self.param("moves_per_worth", nn.initializers.constant(4.0), ())
        self.log_scale = self.param("log_scale", nn.initializers.constant(0.7), ())
        self.pooled = nn.Dense(self.value_features)
        # Initial values near zero: without reward there is no advantage, so nothing is unlearned.
        self.value = nn.Dense(1, kernel_init=nn.initializers.orthogonal(0.01))

    def __call__(self, chart: Bool[Array, "n m 4"]) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the four subgoals and the value of a map, see `raster.draw_map`.

        Source: the worth of the unseen is value iteration (Tamar et al. 2016, Sec. 4); worths in
          moves, and ways to them, are ours.
        """
        return self.predict(self.encode(chart))

    def encode(self, chart: Bool[Array, "n m 4"]) -> Encoding:
        """Searches a map, see `raster.draw_map`, for the best cells; has no gradient."""
        weights = _Weights(self.cells(), self.worths(), self.moves_per_worth)
        options = _Options(self.num_moves, self.look_ahead, self.around)
        return _encode(options, jax.lax.stop_gradient(weights), _own(chart))

    def predict(self, encoding: Encoding) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns logits and value, with the same gradient as a search of the whole map."""
        values = self._worths(encoding.codes) - encoding.moves
        best = values.max()

        # The four values differ by two moves at most, however far the goal is, since the way from
        # any neighbour may lead back through the robot's cell. A move into a wall leaves the robot
        # in its cell: one move lost.
        around = jnp.maximum(values, best - 2.0)
        around = jnp.where(encoding.wall, best - 1.0, around)
        is_something_left = best > planning.NOWHERE / 2
        logits = jnp.where(is_something_left, jnp.exp(self.log_scale) * (around - best), 0.0)
        return logits, self._value(encoding, jnp.where(is_something_left, best, -_FARTHEST))

    def _worths(self, codes: Int[Array, "4 k"]) -> Float[Array, "4"]:
        """Returns the worth of the first cell of each row of codes, in moves."""
        features = _features(codes, _SIZES[self.around])
        _, goal, unseen = (each > 0 for each in features[:_CHANNELS])
        outputs = _apply(self.worths(), nn.relu(_apply(self.cells(), features)))
        reward, gate = _reward_and_gate(outputs[0], outputs[1], unseen)

        # As `planning.value_iteration` computes the first cell's value, from the last cell back.
        worth = reward[:, -1]
        for k in reversed(range(codes.shape[1] - 1)):
            worth = reward[:, k] + gate[:, k] * worth
        return _worth(worth, goal[:, 0], unseen[:, 0], self.moves_per_worth)

    def _value(self, encoding: Encoding, best: Float[Array, ""]) -> Float[Array, ""]:
        """Returns the value, from means over the map and the best cell's worth less its moves."""
        near = jnp.where(best > planning.GOAL / 2.0, best - planning.GOAL, best)
        near = jnp.clip(near, -_FARTHEST, _FARTHEST)
        scalars = jnp.stack([near / _FARTHEST, jnp.exp(near / (_FARTHEST / 2.0))])
        # The value's loss doesn't train worths: these belong to the policy.
        scalars = jax.lax.stop_gradient(scalars)
        seen = self.pooled(jnp.concatenate([encoding.means, scalars, encoding.shares]))
        return self.value(nn.relu(seen))[0]


class _Dense(nn.Module):
    """The weights of a dense layer whose features are the first axis.

    Attributes:
      num_inputs: of the layer.
      num_outputs: of the layer.
      scale: of the first kernel, which is orthogonal.
    """

    num_inputs: int
    num_outputs: int
    scale: float

    @nn.compact
    def __call__(self) -> Layer:
        """Returns kernel and bias, named as in `nn.Dense`."""
        init = nn.initializers.orthogonal(self.scale)
        kernel = self.param("kernel", init, (self.num_inputs, self.num_outputs))
        return kernel, self.param("bias", nn.initializers.zeros, (self.num_outputs,))


class _Weights(NamedTuple):
    """The weights of the search.

    Attributes:
      cells: hidden layer.
      worths: layer after it.
      moves_per_worth: scale of worths.
    """

    cells: Layer
    worths: Layer
    moves_per_worth: Float[Array, ""]


class _Options(NamedTuple):
    """The network's attributes of the same names."""

    num_moves: int | None
    look_ahead: int
    around: str


def _encode(options: _Options, weights: _Weights, chart: Int[Array, "n m"]) -> Encoding:
    """Encodes one map of `_own`; under `vmap`, several with the batch as the last axis."""

    @jax.custom_batching.custom_vmap
    def encode(weights: _Weights, chart: Int[Array, "n m"]) -> Encoding:
        return _encode_codes(options, weights, _codes(chart, options.around))

    @encode.def_vmap
    def encode_batch(
        _: int, is_batched: list[_Weights | bool], weights: _Weights, charts: Array
    ) -> tuple[Encoding, Encoding]:
        if any(jax.tree.leaves(is_batched[0])) or not is_batched[1]:
            axes = jax.tree.map(lambda is_it: 0 if is_it else None, tuple(is_batched))
            encodings = jax.vmap(encode.fun, axes)(weights, charts)
        else:
            encodings = _encode_batch(options, weights, charts)
        return encodings, jax.tree.map(lambda _: True, encodings)

    return encode(weights, chart)


def _encode_batch(options: _Options, weights: _Weights, charts: Int[Array, "B n m"]) -> Encoding:
    """Encodes a batch of maps of `_own`, in parts that fit into the CPU's cache."""
    num, rows, columns = charts.shape
    at_once = max(1, _CACHED // (rows * columns)) if jax.default_backend() == "cpu" else num
    parts = -(-num // at_once)
    size = -(-num // parts)

    charts = jnp.pad(charts, ((0, parts * size - num), (0, 0), (0, 0)), mode="edge")
    charts = jnp.moveaxis(charts.reshape(parts, size, rows, columns), 1, -1)
    if size == 1:
        charts = charts[..., 0]
    # Computed before the loop: inside of it XLA would compute them again at each use.
    codes = jax.vmap(lambda chart: _codes(chart, options.around))(charts)
    encodings = jax.lax.map(functools.partial(_encode_codes, options, weights), codes)
    if size == 1:
        return encodings
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, -1, 1).reshape(parts * size, *leaf.shape[1:-1])[:num],
        encodings,
    )


def _encode_codes(options: _Options, weights: _Weights, codes: Int[Array, "n m *b"]) -> Encoding:
    """Encodes maps of `_codes`."""
    robot = (codes & _ROBOT) > 0
    features = _features(codes, _SIZES[options.around])
    wall, goal, unseen = (each > 0 for each in features[:_CHANNELS])

    hidden = nn.relu(_apply(weights.cells, features))
    outputs = _apply(weights.worths, hidden)
    # Values spread through unseen cells alone: a seen cell has no worth, so no robot stays at it.
    reward, gate = _reward_and_gate(outputs[0], outputs[1], unseen)
    sums, before = planning.value_iteration(reward, gate, options.look_ahead)
    worth = _worth(sums, goal & ~wall, unseen, weights.moves_per_worth)

    # Unseen cells count as free on the way.
    ways = planning.search(worth, ~wall, robot, options.num_moves)
    cells = jnp.stack([planning.followed(before, target) for target in ways.target])
    shares = [each.mean((0, 1), dtype=jnp.float32) for each in (unseen, wall)]
    return Encoding(
        codes=planning.look_up(codes, cells, 0),
        moves=ways.moves,
        wall=planning.at_sides(wall, robot),
        means=hidden.mean((1, 2)),
        shares=jnp.stack([goal.any((0, 1)).astype(jnp.float32), *shares]),
    )


def _own(chart: Bool[Array, "n m 4"]) -> Int[Array, "n m"]:
    """Packs a map into a number per cell: digits for wall, goal and unseen, a bit for the robot."""
    wall, goal, robot, unseen = (chart[..., channel].astype(jnp.int32) for channel in range(4))
    return wall | goal << _DIGIT | unseen << 2 * _DIGIT | robot * _ROBOT


def _codes(chart: Int[Array, "n m *b"], around: str) -> Int[Array, "n m *b"]:
    """Adds to each cell's number how many of its neighbours are wall, goal and unseen.

    Args:
      chart: see `_own`.
      around: see `SearchActorCritic`.

    Returns:
      Three digits for the cell itself (wall, goal, unseen), then three counts over the neighbours
      at its sides and three over those at its corners, as far as `around` says; and the robot's
      bit.
    """
    own = chart & ~_ROBOT
    east, west, north, south = planning.neighbours(own)
    codes, place = chart, _CHANNELS * _DIGIT
    if around != "nothing":
        codes |= (east + west + north + south) << place
    if around == "corners":
        _, _, above, below = planning.neighbours(east + west)
        codes |= (above + below) << 2 * place
    return codes


def _features(codes: Int[Array, "*k"], size: int) -> Float[Array, "F *k"]:
    """Unpacks the digits of codes into `size` times three features."""
    shifts = _DIGIT * jnp.arange(_CHANNELS * size).reshape(-1, *(1,) * codes.ndim)
    return ((codes[None] >> shifts) & ((1 << _DIGIT) - 1)).astype(jnp.float32)


def _apply(layer: Layer, inputs: Float[Array, "i *k"]) -> Float[Array, "o *k"]:
    """Applies a dense layer along the first axis."""
    kernel, bias = layer
    return jnp.tensordot(kernel, inputs, ((0,), (0,))) + bias.reshape(-1, *(1,) * (inputs.ndim - 1))


def _reward_and_gate(
    log_reward: Float[Array, "*k"], opening: Float[Array, "*k"], unseen: Bool[Array, "*k"]
) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """Returns reward and gate of value iteration in unseen cells, zeros in those that are seen."""
    reward = jnp.exp(jnp.clip(log_reward, -_LOG_BOUND, _LOG_BOUND))
    return jnp.where(unseen, reward, 0.0), jnp.where(unseen, nn.sigmoid(opening + _OPEN), 0.0)


def _worth(
    sums: Float[Array, "*k"],
    goal: Bool[Array, "*k"],
    unseen: Bool[Array, "*k"],
    moves_per_worth: Float[Array, ""],
) -> Float[Array, "*k"]:
    """Returns the worth of cells, in moves."""
    logs = jnp.log(jnp.where(unseen, sums, 1.0))
    # The task says that goals pay; that a known goal precedes anything unseen is our design.
    worth = jnp.where(unseen, moves_per_worth * logs, planning.NOWHERE)
    return jnp.where(goal, planning.GOAL, worth)
