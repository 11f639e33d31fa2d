"""Value iteration against a plain loop over cells, and its derivative against automatic ones."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.mazes import paths
from eihrl_jax.ops import planning


def looped(reward, gate, num_iterations):
    """Iterates cell by cell; outside values are 0."""
    rows, columns = reward.shape
    values = reward.copy()
    for _ in range(num_iterations):
        before = values.copy()
        for i in range(rows):
            for j in range(columns):
                around = [
                    before[k, m] if 0 <= k < rows and 0 <= m < columns else 0.0
                    for k, m in ((i, j + 1), (i, j - 1), (i - 1, j), (i + 1, j))
                ]
                values[i, j] = reward[i, j] + gate[i, j] * max(around)
    return values


def differentiated(reward, gate, num_iterations):
    """Does the same with operations whose derivative JAX knows."""
    values = reward
    for _ in range(num_iterations):
        values = reward + gate * jnp.stack(planning.neighbours(values)).max(0)
    return values


def drawn(shape, seed=0):
    rng = np.random.default_rng(seed)
    reward = rng.normal(size=shape).astype(np.float32)
    return reward, rng.uniform(0.3, 1.0, shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(5, 5), (3, 7), (1, 1)])
@pytest.mark.parametrize("num_iterations", [0, 1, 6])
def test_equals_a_loop_over_cells(shape, num_iterations):
    reward, gate = drawn(shape)
    values = jax.jit(planning.value_iteration, static_argnums=2)(reward, gate, num_iterations)
    np.testing.assert_allclose(values, looped(reward, gate, num_iterations), rtol=1e-5, atol=1e-6)


def test_a_reward_travels_around_a_wall_and_fades_with_every_cell():
    reward, gate = jnp.zeros((3, 5)).at[0, 4].set(1.0), jnp.full((3, 5), 0.5)
    gate = gate.at[:2, 2].set(0.0)  # a wall with a gap in the south
    values = planning.value_iteration(reward, gate, 12)
    # Eight moves; from the reward's cell on, coming back pays again.
    assert 0.5**8 < float(values[0, 0]) < 2 * 0.5**8
    assert values[0, 2] == 0.0
    assert values[2, 0] > values[1, 0] > values[0, 0]


@pytest.mark.parametrize("num_iterations", [0, 1, 7])
def test_derivative_equals_the_automatic_one(num_iterations):
    drawings = [drawn((4, 6), seed) for seed in range(3)]
    reward, gate = (jnp.stack(grids) for grids in zip(*drawings, strict=True))
    weights = jax.random.normal(jax.random.key(0), reward.shape)

    def loss(iteration, reward, gate):
        values = jax.vmap(iteration, (0, 0, None))(reward, gate, num_iterations)
        return (weights * jnp.sin(values)).sum()

    ours, theirs = (
        jax.jit(jax.grad(loss, (1, 2)), static_argnums=0)(iteration, reward, gate)
        for iteration in (planning.value_iteration, differentiated)
    )
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


def test_neighbours_lie_where_the_directions_point():
    grid = jnp.arange(12.0).reshape(3, 4) + 1.0
    for (x, y), around in zip(base.DIRECTIONS_XY, planning.neighbours(grid), strict=True):
        assert around[1, 1] == grid[1 - int(y), 1 + int(x)]
    east, west, north, south = planning.neighbours(grid)
    assert not east[:, -1].any() and not west[:, 0].any()
    assert not north[0].any() and not south[-1].any()


def walled(shape, seed=0):
    """Draws worths, of which few are something, and walls."""
    rng = np.random.default_rng(seed)
    worth = np.where(rng.random(shape) < 0.2, 5.0 * rng.normal(size=shape), planning.NOWHERE)
    return jnp.asarray(worth, jnp.float32), jnp.asarray(rng.random(shape) < 0.7)


def shortest(worth, is_open, num_moves):
    """Returns the greatest worth less the moves to it, over all cells, by breadth-first search."""
    worth, is_open = np.asarray(worth), np.asarray(is_open)
    values = np.full(worth.shape, planning.NOWHERE)
    for i, j in np.argwhere(is_open & (worth > planning.NOWHERE)).tolist():
        moves = paths.distances(is_open, [(i, j)])
        there = worth[i, j] - moves
        values = np.where((moves >= 0) & (moves <= num_moves), np.maximum(values, there), values)
    return values


@pytest.mark.parametrize("shape", [(6, 6), (3, 9), (1, 1)])
@pytest.mark.parametrize("num_moves", [0, 1, 5, 30])
@pytest.mark.parametrize("seed", range(3))
def test_reach_finds_the_shortest_ways(shape, num_moves, seed):
    worth, is_open = walled(shape, seed)
    values = np.asarray(jax.jit(planning.reach, static_argnums=2)(worth, is_open, num_moves))
    expected = shortest(worth, is_open, num_moves)
    is_reached = expected > planning.NOWHERE
    np.testing.assert_array_equal(values > planning.NOWHERE / 2, is_reached)
    np.testing.assert_allclose(values[is_reached], expected[is_reached], atol=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_search_is_right_around_the_robot(seed):
    worth, is_open = walled((9, 9), seed)
    whole = np.asarray(planning.reach(worth, is_open, 81))
    for cell in np.argwhere(np.asarray(is_open))[::5]:
        robot = np.zeros((9, 9), bool)
        robot[tuple(cell)] = True
        found, expected = (
            np.array([np.asarray(grid)[tuple(cell)] for grid in planning.neighbours(values)])
            for values in (jax.jit(planning.search)(worth, is_open, robot), jnp.asarray(whole))
        )
        # What is outside of the grid isn't looked at.
        found, expected = (
            np.where(around == 0.0, planning.NOWHERE, around) for around in (found, expected)
        )
        least = expected.max() - 2.0
        np.testing.assert_allclose(np.maximum(found, least), np.maximum(expected, least), atol=1e-5)


@pytest.mark.parametrize("num_moves", [0, 12])
def test_derivative_of_reach_equals_the_automatic_one(num_moves):
    drawings = [walled((5, 6), seed) for seed in range(3)]
    worth, is_open = (jnp.stack(grids) for grids in zip(*drawings, strict=True))
    weights = jax.random.normal(jax.random.key(0), worth.shape)

    def automatic(worth, is_open, num_moves):
        worth = values = jnp.where(is_open, worth, planning.NOWHERE)
        for _ in range(num_moves):
            padded = jnp.pad(values, 1, constant_values=planning.NOWHERE)
            around = padded[1:-1, 2:], padded[1:-1, :-2], padded[:-2, 1:-1], padded[2:, 1:-1]
            further = jnp.maximum(worth, functools.reduce(jnp.maximum, around) - 1.0)
            values = jnp.where(is_open, further, planning.NOWHERE)
        return values

    def loss(reach, worth):
        values = jax.vmap(reach, (0, 0, None))(worth, is_open, num_moves)
        is_reached = values > planning.NOWHERE / 2
        return jnp.where(
            is_reached, weights * jnp.sin(jnp.where(is_reached, values, 0.0)), 0.0
        ).sum()

    ours = jax.jit(jax.grad(lambda worth: loss(planning.reach, worth)))(worth)
    theirs = jax.jit(jax.grad(lambda worth: loss(automatic, worth)))(worth)
    np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-3)
    assert np.abs(np.asarray(ours)).max() > 0.1
