"""Value iteration against a plain loop over cells, and ways against breadth-first search."""

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


def drawn(shape, seed=0):
    rng = np.random.default_rng(seed)
    reward = rng.normal(size=shape).astype(np.float32)
    return reward, rng.uniform(0.3, 1.0, shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(5, 5), (3, 7), (1, 1)])
@pytest.mark.parametrize("num_iterations", [0, 1, 6])
def test_equals_a_loop_over_cells(shape, num_iterations):
    reward, gate = drawn(shape)
    iterate = jax.jit(planning.value_iteration, static_argnums=2)
    values, before = iterate(reward, gate, num_iterations)
    np.testing.assert_allclose(values, looped(reward, gate, num_iterations), rtol=1e-5, atol=1e-6)
    assert before.shape == (num_iterations, *shape)
    # A batch comes last.
    of_two, _ = iterate(
        *(np.stack([grid, grid[::-1]], -1) for grid in (reward, gate)), num_iterations
    )
    np.testing.assert_allclose(of_two[..., 0], values, rtol=1e-6)
    np.testing.assert_allclose(of_two[..., 1], values[::-1], rtol=1e-6)


def test_a_reward_travels_around_a_wall_and_fades_with_every_cell():
    reward, gate = jnp.zeros((3, 5)).at[0, 4].set(1.0), jnp.full((3, 5), 0.5)
    gate = gate.at[:2, 2].set(0.0)  # a wall with a gap in the south
    values, _ = planning.value_iteration(reward, gate, 12)
    # Eight moves; from the reward's cell on, coming back pays again.
    assert 0.5**8 < float(values[0, 0]) < 2 * 0.5**8
    assert values[0, 2] == 0.0
    assert values[2, 0] > values[1, 0] > values[0, 0]


@pytest.mark.parametrize("num_iterations", [0, 1, 7])
def test_a_value_consists_of_the_cells_that_it_is_followed_to(num_iterations):
    reward, gate = drawn((4, 6))
    iterate = jax.jit(planning.value_iteration, static_argnums=2)
    values, before = iterate(reward, gate, num_iterations)
    cells = np.array([0, 9, 23, -1])
    followed = planning.followed(jnp.stack([before] * 4, -1), jnp.asarray(cells))
    assert followed.shape == (num_iterations + 1, 4) and (followed[0] == cells).all()

    # Outside the grid, as behind the last cell, there is nothing.
    sums = np.zeros(4)
    for chain in np.asarray(followed)[::-1]:
        sums = np.where(chain < 0, 0.0, reward.ravel()[chain] + gate.ravel()[chain] * sums)
    np.testing.assert_allclose(sums[:3], values.ravel()[cells[:3]], rtol=1e-5)
    assert (followed[:, 3] == -1).all()


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


@pytest.mark.parametrize("shape", [(9, 9), (40, 5)])
@pytest.mark.parametrize("num_moves", [None, 0, 1, 5])
def test_search_is_right_around_the_robot(shape, num_moves):
    """In many maps at once: all robots of a map are a batch, which comes last."""
    worth, is_open = walled(shape, num_moves or 7)
    cells = np.array([cell for cell in np.argwhere(np.asarray(is_open)) if _is_inside(cell, shape)])
    robots = np.zeros((*shape, len(cells)), bool)
    robots[cells[:, 0], cells[:, 1], np.arange(len(cells))] = True
    grids = (jnp.repeat(jnp.asarray(grid)[..., None], len(cells), -1) for grid in (worth, is_open))
    search = jax.jit(planning.search, static_argnums=3)
    ways = jax.tree.map(np.asarray, search(*grids, jnp.asarray(robots), num_moves))

    num_right = 0
    for k, (i, j) in enumerate(cells):
        # What the robot's own cell is worth doesn't count.
        others = np.asarray(worth).copy()
        others[i, j] = planning.NOWHERE
        limit = 10**6 if num_moves is None else num_moves
        values = shortest(others, is_open, limit)
        expected = np.array(
            [values[i, j + 1], values[i, j - 1], values[i - 1, j], values[i + 1, j]]
        )
        least = expected.max() - 2.0
        found = ways.value[:, k]
        np.testing.assert_allclose(np.maximum(found, least), np.maximum(expected, least), atol=1e-5)

        # Each value is that of the cell named.
        is_way = ways.target[:, k] >= 0
        there = others.ravel()[ways.target[is_way, k]] - ways.moves[is_way, k]
        np.testing.assert_allclose(there, found[is_way], atol=1e-5)
        assert (found[~is_way] == planning.NOWHERE).all()
        num_right += is_way.sum()
    assert num_right > len(cells) or num_moves == 0

    one = search(worth, is_open, jnp.asarray(robots[..., 0]), num_moves)
    best = ways.value[:, 0].max() - 2.0
    np.testing.assert_allclose(
        np.maximum(one.value, best), np.maximum(ways.value[:, 0], best), atol=1e-6
    )


def _is_inside(cell, shape):
    return all(0 < place < size - 1 for place, size in zip(cell, shape, strict=True))
