"""Search turns and mirrors with its map, has neither traps nor a horizon, and differs by moves."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eihrl_jax import base
from eihrl_jax.mazes import paths
from eihrl_jax.networks import search
from eihrl_jax.ops import planning

MARGIN = 3
SIDE = 31 + 2 * MARGIN
"""All mazes lie on a grid of one size, so that one program serves them; what is outside is wall."""

NETWORK = search.SearchActorCritic(num_moves=None, look_ahead=3, cell_features=4, value_features=4)
DIRECTIONS_IJ = [(-int(y), int(x)) for x, y in base.DIRECTIONS_XY]


def charts(num, size=7):
    """Draws maps of anything."""
    return jax.random.bernoulli(jax.random.key(0), 0.4, (num, size, size, 4))


def directions_after(change):
    """Returns for each direction the index of the one that it becomes on a changed map."""
    found = []
    for x, y in base.DIRECTIONS_XY:
        grid = np.zeros((3, 3))
        grid[1 - int(y), 1 + int(x)] = 1.0
        i, j = np.argwhere(change(grid))[0]
        found.append([tuple(d) for d in base.DIRECTIONS_XY].index((j - 1, 1 - i)))
    return found


@functools.cache
def _init():
    chart = jnp.zeros((SIDE, SIDE, 4), bool).at[1, 1, 2].set(True)
    return jax.jit(NETWORK.init)(jax.random.key(0), chart)


@functools.cache
def _logits():
    return jax.jit(lambda params, chart: NETWORK.apply(params, chart)[0])


def _weights(seed, scale):
    """Draws any weights: what is proved hangs on none of them."""
    leaves, structure = jax.tree.flatten(_init())
    rng = np.random.default_rng(seed)
    drawn = [scale * rng.normal(size=leaf.shape).astype(np.float32) for leaf in leaves]
    return jax.tree.unflatten(structure, drawn)


def _maze(seed, rows, columns, wall_share):
    """Draws walls, a start and up to three goals that can be reached from it."""
    rng = np.random.default_rng(seed)
    wall = np.ones((SIDE, SIDE), bool)
    wall[MARGIN : MARGIN + rows, MARGIN : MARGIN + columns] = (
        rng.random((rows, columns)) < wall_share
    )
    free = paths.largest_part(~wall)
    cells = np.argwhere(free)
    chosen = cells[rng.permutation(len(cells))[:4]]
    goal = np.zeros_like(wall)
    goal[tuple(chosen[1:].T)] = True
    return wall, goal, tuple(chosen[0]), len(cells)


def _explore(choose, wall, goal, cell, limit):
    """Lets a robot that sees 5 x 5 cells move; returns its moves, and how many goals are left."""
    seen, goal = np.zeros_like(wall), goal.copy()
    for moves in range(limit + 1):
        i, j = cell
        seen[i - 2 : i + 3, j - 2 : j + 3] = True
        goal[cell] = False
        if not goal.any() or moves == limit:
            return moves, int(goal.sum())
        robot = np.zeros_like(wall)
        robot[cell] = True
        chart = np.stack([seen & wall, seen & goal, robot, ~seen], -1)
        di, dj = DIRECTIONS_IJ[choose(chart)]
        if not wall[i + di, j + dj]:
            cell = (i + di, j + dj)
    raise AssertionError


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(2, 31),
    columns=st.integers(2, 31),
    wall_share=st.floats(0.0, 0.45),
    scale=st.sampled_from([0.1, 1.0, 3.0]),
)
def test_every_goal_is_reached_with_any_weights(seed, rows, columns, wall_share, scale):
    """Within the bound of docs/planning.md."""
    wall, goal, start, num_free = _maze(seed, rows, columns, wall_share)
    params = _weights(seed, scale)

    def choose(chart):
        return int(np.argmax(_logits()(params, chart)))

    # Each phase ends with something new in sight or a goal, and is no longer than a way.
    num_phases = (rows + 4) * (columns + 4) + int(goal.sum())
    moves, left = _explore(choose, wall, goal, start, num_phases * num_free)
    assert left == 0 and moves <= num_phases * num_free


@pytest.mark.parametrize("seed", range(3))
def test_sampled_directions_reach_every_goal_too(seed):
    wall, goal, start, num_free = _maze(seed, 21, 21, 0.35)
    rng = np.random.default_rng(seed)
    params = _init()

    def choose(chart):
        return int(np.argmax(np.asarray(_logits()(params, chart)) + rng.gumbel(size=4)))

    assert _explore(choose, wall, goal, start, 20 * num_free)[1] == 0


def test_a_choice_means_the_same_near_and_far():
    """A goal at the end of a corridor of 1 to 25 cells: the same logits wherever it is."""
    found = []
    for distance in (1, 2, 7, 25):
        chart = np.zeros((SIDE, SIDE, 4), bool)
        chart[..., 0] = True
        chart[5, 2 : 5 + distance, 0] = False
        chart[5, 4 + distance, 1] = True
        chart[5, 4, 2] = True
        found.append(_logits()(_init(), chart))
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-4)
    east, west, north, south = found[0]
    # One move forward, one lost at a wall, two on the way back.
    assert east > north == south > west
    np.testing.assert_allclose(east - west, 2.0 * (east - north), rtol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_an_untrained_network_heads_for_what_it_has_not_seen_and_first_for_a_goal(seed):
    """Walls all around but for gaps in the south and, after a longer way, in the west."""
    chart = np.zeros((11, 11, 4), bool)
    chart[2:9, 2:9, 0] = True
    chart[3:8, 3:8, 0] = False
    chart[5, 5, 2] = True
    chart[8, 5, 0] = chart[3, 2, 0] = False
    chart[..., 3] = True
    chart[2:9, 2:9, 3] = False
    params = jax.jit(NETWORK.init)(jax.random.key(seed), chart)
    apply = jax.jit(NETWORK.apply)
    assert jax.nn.softmax(apply(params, chart)[0])[3] > 0.5
    chart[2, 7, :2] = False, True  # a goal in the wall to the north
    assert jnp.argmax(apply(params, chart)[0]) in (0, 2)


def test_where_nothing_is_left_all_directions_are_alike():
    chart = jnp.zeros((SIDE, SIDE, 4), bool).at[4, 4, 2].set(True)
    logits, value = jax.jit(NETWORK.apply)(_init(), chart)
    assert not logits.any() and jnp.isfinite(value)


@pytest.mark.parametrize("around", ["nothing", "sides", "corners"])
@pytest.mark.parametrize(("turns", "is_mirrored"), [(1, False), (2, True)])
def test_logits_turn_and_mirror_with_the_map(turns, is_mirrored, around):
    def change(grid):
        return np.rot90(grid[:, ::-1] if is_mirrored else grid, turns)

    batch = charts(6, 9).at[..., 2].set(False).at[:, 4, 4, 2].set(True)
    network = search.SearchActorCritic(num_moves=8, look_ahead=3, around=around)
    params = jax.jit(network.init)(jax.random.key(1), batch[0])
    apply = jax.jit(jax.vmap(network.apply, (None, 0)))
    logits, values = apply(params, batch)
    changed = jnp.stack([jnp.asarray(change(np.asarray(chart)).copy()) for chart in batch])
    turned, same = apply(params, changed)
    np.testing.assert_allclose(turned[:, np.array(directions_after(change))], logits, atol=1e-4)
    np.testing.assert_allclose(values, same, atol=1e-5)
    assert (np.ptp(np.asarray(logits), axis=1) > 1e-2).all()


def test_training_s_limited_ways_and_any_ways_agree_where_the_limit_suffices():
    batch = charts(8, 9).at[..., 2].set(False).at[:, 4, 4, 2].set(True)
    limited = search.SearchActorCritic(num_moves=40, look_ahead=3)
    params = limited.init(jax.random.key(1), batch[0])
    logits, values = jax.jit(jax.vmap(limited.apply, (None, 0)))(params, batch)
    endless = search.SearchActorCritic(num_moves=None, look_ahead=3)
    found, same = jax.jit(jax.vmap(endless.apply, (None, 0)))(params, batch)
    np.testing.assert_allclose(found, logits, atol=1e-5)
    np.testing.assert_allclose(same, values, atol=1e-5)


def _whole_map(params, chart, num_moves, look_ahead):
    """Logits and value with operations whose derivative JAX knows, every cell looked at."""

    def dense(name, inputs):
        kernel, bias = (params["params"][name][part] for part in ("kernel", "bias"))
        return inputs @ kernel + jnp.broadcast_to(bias, (*inputs.shape[:-1], len(bias)))

    def best_beside(grid, outside):
        padded = jnp.pad(grid, 1, constant_values=outside)
        around = padded[1:-1, 2:], padded[1:-1, :-2], padded[:-2, 1:-1], padded[2:, 1:-1]
        return functools.reduce(jnp.maximum, around)

    wall, goal, robot, unseen = (chart[..., channel] for channel in range(4))
    grid = jnp.stack([wall, goal, unseen], -1).astype(jnp.float32)
    padded = jnp.pad(grid, ((1, 1), (1, 1), (0, 0)))
    sides = padded[1:-1, 2:] + padded[1:-1, :-2] + padded[:-2, 1:-1] + padded[2:, 1:-1]
    hidden = jax.nn.relu(dense("cells", jnp.concatenate([grid, sides], -1)))
    outputs = dense("worths", hidden)
    reward = jnp.where(unseen, jnp.exp(jnp.clip(outputs[..., 0], -10.0, 10.0)), 0.0)
    gate = jnp.where(unseen, jax.nn.sigmoid(outputs[..., 1] + 3.0), 0.0)
    sums = reward
    for _ in range(look_ahead):
        sums = reward + gate * best_beside(sums, 0.0)

    logs = jnp.log(jnp.where(unseen, sums, 1.0))
    worth = jnp.where(unseen, params["params"]["moves_per_worth"] * logs, planning.NOWHERE)
    worth = jnp.where(goal, planning.GOAL, worth)
    worth = values = jnp.where(wall, planning.NOWHERE, worth)
    for _ in range(num_moves):
        further = jnp.maximum(worth, best_beside(values, planning.NOWHERE) - 1.0)
        values = jnp.where(wall, planning.NOWHERE, further)

    around, beside_wall = planning.at_sides(values, robot), planning.at_sides(wall, robot)
    best = around.max()
    around = jnp.where(beside_wall, best - 1.0, jnp.maximum(around, best - 2.0))
    near = jnp.clip(jnp.where(best > planning.GOAL / 2, best - planning.GOAL, best), -30.0, 30.0)
    shares = jnp.stack([goal.any().astype(jnp.float32), unseen.mean(), wall.mean()])
    pooled = [hidden.mean((0, 1)), jnp.stack([near / 30.0, jnp.exp(near / 15.0)]), shares]
    seen = jax.nn.relu(dense("pooled", jax.lax.stop_gradient(jnp.concatenate(pooled))))
    logits = jnp.exp(params["params"]["log_scale"]) * (around - best)
    return logits, dense("value", seen)[0]


def test_equals_looking_at_every_cell_and_so_does_its_derivative():
    """In more maps at once than are looked at together."""
    rng = np.random.default_rng(0)
    kinds = rng.choice(4, (900, 9, 9), p=[0.48, 0.25, 0.01, 0.26])
    kinds[:, 4, 4] = 0
    batch = np.stack([kinds == 1, kinds == 2, np.zeros_like(kinds, bool), kinds == 3], -1)
    batch[:, 4, 4, 2] = True
    network = search.SearchActorCritic(num_moves=12, look_ahead=3)
    shapes = jax.eval_shape(network.init, jax.random.key(0), batch[0])
    params = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape).astype(np.float32), shapes)
    weights = rng.normal(size=(900, 5)).astype(np.float32)
    assert (900 * 81) > search._CACHED

    def loss(params, batch, apply):
        logits, values = jax.vmap(apply, (None, 0))(params, batch)
        return (weights * jnp.append(logits, values[:, None], 1)).mean(), (logits, values)

    def whole_map(params, chart):
        return _whole_map(params, chart, 12, 3)

    (ours, found), (theirs, expected) = (
        jax.jit(jax.grad(functools.partial(loss, apply=apply), has_aux=True))(params, batch)
        for apply in (network.apply, whole_map)
    )
    np.testing.assert_allclose(found[0], expected[0], atol=1e-2)  # of 2: a goal's worth is large
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-4, atol=1e-4)
    assert (np.ptp(np.asarray(found[0]), axis=1) > 0).mean() > 0.9
    for one, other in zip(*(jax.tree.leaves(grads) for grads in (ours, theirs)), strict=True):
        scale = np.abs(other).max()
        assert scale > 0.0
        np.testing.assert_allclose(one, other, atol=1e-3 * scale)
