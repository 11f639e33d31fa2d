"""Value iteration against a plain loop over cells, and its derivative against automatic ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
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
