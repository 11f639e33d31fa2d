"""The planner turns and mirrors with its map and goes around walls."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.networks import planner

NETWORK = planner.PlanningActorCritic(num_iterations=6, cell_features=5, value_features=4)


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


@pytest.mark.parametrize("around", ["nothing", "sides", "corners"])
@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_logits_turn_and_mirror_with_the_map(turns, is_mirrored, around):
    network = planner.PlanningActorCritic(6, 5, 4, around)

    def change(grid):
        return np.rot90(grid[:, ::-1] if is_mirrored else grid, turns)

    batch = charts(5)
    params = network.init(jax.random.key(1), batch[0])
    logits, _ = jax.vmap(network.apply, (None, 0))(params, batch)
    changed = jnp.stack([jnp.asarray(change(np.asarray(chart)).copy()) for chart in batch])
    turned, _ = jax.vmap(network.apply, (None, 0))(params, changed)
    np.testing.assert_allclose(turned[:, np.array(directions_after(change))], logits, atol=1e-5)
    assert (np.ptp(np.asarray(logits), axis=1) > 1e-4).sum() >= 4  # walls all around say nothing


def test_goal_behind_a_wall_is_approached_around_it():
    """With weights set by hand, goals are worth 1 and nothing else is learned."""
    chart = jnp.zeros((7, 7, 4), bool)
    chart = chart.at[3, 5, 1].set(True).at[:5, 4, 0].set(True)  # the wall's gap is in the south
    params = NETWORK.init(jax.random.key(1), chart)["params"]
    params = jax.tree.map(jnp.zeros_like, params)
    first = params["Dense_0"]["kernel"].at[1, 0].set(1.0)
    second = params["Dense_1"]["kernel"].at[0, 0].set(1.0)
    params |= {"Dense_0": params["Dense_0"] | {"kernel": first}}
    params |= {"Dense_1": params["Dense_1"] | {"kernel": second}}
    logits, _ = planner.PlanningActorCritic(12, 5, 4).apply({"params": params}, chart)
    assert jnp.argmax(logits) == 3  # south
    straight, _ = planner.PlanningActorCritic(12, 5, 4).apply(
        {"params": params}, chart.at[:, 4, 0].set(False)
    )
    assert jnp.argmax(straight) == 0  # east


@pytest.mark.parametrize("seed", range(5))
def test_untrained_planner_heads_for_what_it_has_not_seen(seed):
    """Walls all around but for a gap in the south, behind which nothing has been seen."""
    chart = jnp.zeros((7, 7, 4), bool)
    chart = chart.at[1, 1:6, 0].set(True).at[5, 1:6, 0].set(True)
    chart = chart.at[1:6, 1, 0].set(True).at[1:6, 5, 0].set(True).at[5, 3, 0].set(False)
    chart = chart.at[6, :, 3].set(True)
    params = NETWORK.init(jax.random.key(seed), chart)
    logits, _ = NETWORK.apply(params, chart)
    assert jax.nn.softmax(logits)[3] > 0.5
