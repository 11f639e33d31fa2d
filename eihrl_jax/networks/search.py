"""Policy and value of the high level from a map, by shortest ways to what is worth most on it.

Something is worth going for only where nothing has been seen yet, or where a goal waits. A goal on
the map comes first. How much the unseen is worth, counted in moves, is learned from the cell and
those around it, and from how far the unseen goes on behind it. Of all that is left, the robot goes
for what is worth most less the moves to get there.

So there are no traps and no horizon: with any weights, each move comes one nearer to something that
is new, and every goal that can be reached is reached (docs/planning.md). No weight knows where on
the map it is used, how large the map is, or which way it looks.

A map is looked at as a whole once (`look`). What it comes down to are the few cells of which the
best values consist, and of those alone logits and value are computed and learned (`judge`).
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
"""Logit of the first gates: 0.95, so that the unseen is worth more the farther it goes on."""

_FAINT = 0.03
"""Scale of the last layer's first weights: at first all that is unseen is worth the same."""

_LOG_BOUND = 10.0
"""Greatest size of a worth's logarithm, so that all worths are finite."""

_FARTHEST = 30.0
"""Moves beyond which the value doesn't tell distances apart."""

_DIGIT = 3  # bits of a code that hold 0 to 4 cells
_CHANNELS = 3  # wall, goal, unseen
_ROBOT = 1 << 27  # bit of a code beyond its digits

_CACHED = 2**15
"""Cells of the maps that a processor looks at together: what is made of them stays in its cache."""

_SIZES = {"nothing": 1, "sides": 2, "corners": 3}

Layer: TypeAlias = tuple[Float[Array, "i o"], Float[Array, " o"]]
"""Kernel and bias."""


class Evidence(struct.PyTreeNode):
    """What logits and value hang on. The cells that count for each side are K + 1.

    Attributes:
      codes: int32 [4, K + 1], the best cell to go for through each of the four cells around the
        robot's, and those behind it of which its worth consists; see `_codes`.
      moves: float32 [4], to the best cell from that around the robot's.
      wall: bool [4], whether a wall stands around the robot's cell.
      means: float32 [F], of what the hidden layer makes of the map's cells.
      shares: float32 [3], whether there is a goal, and the unseen's and the walls' share of cells.
    """

    codes: Int[Array, "4 k *b"]
    moves: Float[Array, "4 *b"]
    wall: Bool[Array, "4 *b"]
    means: Float[Array, "F *b"]
    shares: Float[Array, "3 *b"]


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

    def setup(self) -> None:
        """Names the parameters."""
        num_inputs = _CHANNELS * _SIZES[self.around]
        self.cells = _Dense(num_inputs, self.cell_features, 2**0.5)
        self.worths = _Dense(self.cell_features, 2, _FAINT)
        self.moves_per_worth = self.param("moves_per_worth", nn.initializers.constant(4.0), ())
        self.log_scale = self.param("log_scale", nn.initializers.constant(0.7), ())
        self.pooled = nn.Dense(self.value_features)
        # A first value of zero: without a reward no advantage, so nothing is unlearned by chance.
        self.value = nn.Dense(1, kernel_init=nn.initializers.orthogonal(0.01))

    def __call__(self, chart: Bool[Array, "n m 4"]) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns the logits of the four subgoals and the value of a map, see `raster.draw_map`.

        Source: the worth of the unseen is value iteration (Tamar et al. 2016, Sec. 4); worths in
          moves, and ways to them, are ours.
        """
        return self.judge(self.look(chart))

    def look(self, chart: Bool[Array, "n m 4"]) -> Evidence:
        """Returns what there is to go for on a map; nothing is learned of how it was found."""
        weights = _Weights(self.cells(), self.worths(), self.moves_per_worth)
        options = _Options(self.num_moves, self.look_ahead, self.around)
        return _look(options, jax.lax.stop_gradient(weights), _own(chart))

    def judge(self, evidence: Evidence) -> tuple[Float[Array, "4"], Float[Array, ""]]:
        """Returns logits and value, whose derivatives are those of the whole map's."""
        values = self._worths(evidence.codes) - evidence.moves
        best = values.max()

        # A move is a move near and far: the four differ by two moves at most, wherever the goal is,
        # for one can come back through the robot's cell; who bumps into a wall stays in it.
        around = jnp.maximum(values, best - 2.0)
        around = jnp.where(evidence.wall, best - 1.0, around)
        is_something_left = best > planning.NOWHERE / 2
        logits = jnp.where(is_something_left, jnp.exp(self.log_scale) * (around - best), 0.0)
        return logits, self._value(evidence, jnp.where(is_something_left, best, -_FARTHEST))

    def _worths(self, codes: Int[Array, "4 k"]) -> Float[Array, "4"]:
        """Returns what going to the first of some cells is worth, in moves."""
        features = _features(codes, _SIZES[self.around])
        _, goal, unseen = (each > 0 for each in features[:_CHANNELS])
        outputs = _apply(self.worths(), nn.relu(_apply(self.cells(), features)))
        reward, gate = _reward_and_gate(outputs[0], outputs[1], unseen)

        # What `planning.value_iteration` makes of the first cell, from the last one on.
        worth = reward[:, -1]
        for k in reversed(range(codes.shape[1] - 1)):
            worth = reward[:, k] + gate[:, k] * worth
        return _worth(worth, goal[:, 0], unseen[:, 0], self.moves_per_worth)

    def _value(self, evidence: Evidence, best: Float[Array, ""]) -> Float[Array, ""]:
        """Returns the value, from means over the map and the way to what the robot goes for."""
        near = jnp.where(best > planning.GOAL / 2.0, best - planning.GOAL, best)
        near = jnp.clip(near, -_FARTHEST, _FARTHEST)
        scalars = jnp.stack([near / _FARTHEST, jnp.exp(near / (_FARTHEST / 2.0))])
        # The policy's part is left to the policy's loss.
        scalars = jax.lax.stop_gradient(scalars)
        seen = self.pooled(jnp.concatenate([evidence.means, scalars, evidence.shares]))
        return self.value(nn.relu(seen))[0]


class _Dense(nn.Module):
    """The weights of a dense layer, for features that come first.

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
    """What decides where to go.

    Attributes:
      cells: hidden layer.
      worths: layer behind it.
      moves_per_worth: scale of worths.
    """

    cells: Layer
    worths: Layer
    moves_per_worth: Float[Array, ""]


class _Options(NamedTuple):
    """Those of the network of the same names."""

    num_moves: int | None
    look_ahead: int
    around: str


def _look(options: _Options, weights: _Weights, chart: Int[Array, "n m"]) -> Evidence:
    """Looks at one map of `_own`, and under `vmap` at many with the batch as the last axis."""

    @jax.custom_batching.custom_vmap
    def look(weights: _Weights, chart: Int[Array, "n m"]) -> Evidence:
        return _look_at(options, weights, _codes(chart, options.around))

    @look.def_vmap
    def look_at_many(
        _: int, is_batched: list[_Weights | bool], weights: _Weights, charts: Array
    ) -> tuple[Evidence, Evidence]:
        if any(jax.tree.leaves(is_batched[0])) or not is_batched[1]:
            axes = jax.tree.map(lambda is_it: 0 if is_it else None, tuple(is_batched))
            found = jax.vmap(look.fun, axes)(weights, charts)
        else:
            found = _look_at_many(options, weights, charts)
        return found, jax.tree.map(lambda _: True, found)

    return look(weights, chart)


def _look_at_many(options: _Options, weights: _Weights, charts: Int[Array, "B n m"]) -> Evidence:
    """Looks at many maps of `_own`, as many at once as the processor's cache has room for."""
    num, rows, columns = charts.shape
    at_once = max(1, _CACHED // (rows * columns)) if jax.default_backend() == "cpu" else num
    parts = -(-num // at_once)
    size = -(-num // parts)

    charts = jnp.pad(charts, ((0, parts * size - num), (0, 0), (0, 0)), mode="edge")
    charts = jnp.moveaxis(charts.reshape(parts, size, rows, columns), 1, -1)
    if size == 1:
        charts = charts[..., 0]
    # Made before the loop, so that XLA doesn't make them anew wherever they are used in it.
    codes = jax.vmap(lambda chart: _codes(chart, options.around))(charts)
    found = jax.lax.map(functools.partial(_look_at, options, weights), codes)
    if size == 1:
        return found
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, -1, 1).reshape(parts * size, *leaf.shape[1:-1])[:num], found
    )


def _look_at(options: _Options, weights: _Weights, codes: Int[Array, "n m *b"]) -> Evidence:
    """Looks at maps of `_codes`."""
    robot = (codes & _ROBOT) > 0
    features = _features(codes, _SIZES[options.around])
    wall, goal, unseen = (each > 0 for each in features[:_CHANNELS])

    hidden = nn.relu(_apply(weights.cells, features))
    outputs = _apply(weights.worths, hidden)
    # Values travel through the unseen alone: what is seen has no worth that could hold a robot.
    reward, gate = _reward_and_gate(outputs[0], outputs[1], unseen)
    sums, before = planning.value_iteration(reward, gate, options.look_ahead)
    worth = _worth(sums, goal & ~wall, unseen, weights.moves_per_worth)

    # Ways lead through what hasn't been seen, as if nothing were there.
    ways = planning.search(worth, ~wall, robot, options.num_moves)
    cells = jnp.stack([planning.followed(before, target) for target in ways.target])
    shares = [each.mean((0, 1), dtype=jnp.float32) for each in (unseen, wall)]
    return Evidence(
        codes=planning.look_up(codes, cells, 0),
        moves=ways.moves,
        wall=planning.at_sides(wall, robot),
        means=hidden.mean((1, 2)),
        shares=jnp.stack([goal.any((0, 1)).astype(jnp.float32), *shares]),
    )


def _own(chart: Bool[Array, "n m 4"]) -> Int[Array, "n m"]:
    """Returns a number per cell: a digit for each of wall, goal and unseen, and who is there."""
    wall, goal, robot, unseen = (chart[..., channel].astype(jnp.int32) for channel in range(4))
    return wall | goal << _DIGIT | unseen << 2 * _DIGIT | robot * _ROBOT


def _codes(chart: Int[Array, "n m *b"], around: str) -> Int[Array, "n m *b"]:
    """Returns what stands in each cell and around it, in digits.

    Args:
      chart: see `_own`.
      around: see `SearchActorCritic`.

    Returns:
      The first three digits tell whether the cell is wall, a goal, or unseen; the next three how
      many at its sides are, the last three how many at its corners, as far as `around` says; and
      who is there.
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
    """Returns the digits of codes, of `size` times the channels."""
    shifts = _DIGIT * jnp.arange(_CHANNELS * size).reshape(-1, *(1,) * codes.ndim)
    return ((codes[None] >> shifts) & ((1 << _DIGIT) - 1)).astype(jnp.float32)


def _apply(layer: Layer, inputs: Float[Array, "i *k"]) -> Float[Array, "o *k"]:
    """Applies a dense layer to features that come first."""
    kernel, bias = layer
    return jnp.tensordot(kernel, inputs, ((0,), (0,))) + bias.reshape(-1, *(1,) * (inputs.ndim - 1))


def _reward_and_gate(
    log_reward: Float[Array, "*k"], opening: Float[Array, "*k"], unseen: Bool[Array, "*k"]
) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """Returns what values of the unseen are made of; nothing where something has been seen."""
    reward = jnp.exp(jnp.clip(log_reward, -_LOG_BOUND, _LOG_BOUND))
    return jnp.where(unseen, reward, 0.0), jnp.where(unseen, nn.sigmoid(opening + _OPEN), 0.0)


def _worth(
    sums: Float[Array, "*k"],
    goal: Bool[Array, "*k"],
    unseen: Bool[Array, "*k"],
    moves_per_worth: Float[Array, ""],
) -> Float[Array, "*k"]:
    """Returns what going to a cell is worth, in moves."""
    logs = jnp.log(jnp.where(unseen, sums, 1.0))
    # That goals pay is known; that one on the map comes before all that is new is ours.
    worth = jnp.where(unseen, moves_per_worth * logs, planning.NOWHERE)
    return jnp.where(goal, planning.GOAL, worth)
