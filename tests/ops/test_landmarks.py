import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax.config import higl
from eihrl_jax.ops import landmarks


def test_farthest_points_are_those_of_a_plain_loop():
    xy = np.asarray(jax.random.uniform(jax.random.key(0), (50, 2)))
    chosen = [0]
    while len(chosen) < 8:
        distance = np.linalg.norm(xy[:, None] - xy[chosen][None], axis=-1).min(1)
        chosen.append(int(distance.argmax()))
    assert landmarks.farthest_points(jnp.asarray(xy), 8).tolist() == chosen


def test_edges_beyond_the_cutoff_are_cut_but_each_target_keeps_its_best():
    values = jnp.array([[-1.0, -5.0, -90.0], [-6.0, -1.0, -60.0], [-50.0, -7.0, -1.0]])
    edges = np.asarray(landmarks.cut_edges(values, -38.0, jnp.arange(3)))
    assert np.diagonal(edges).tolist() == [0.0, 0.0, 0.0]
    is_cut = edges < landmarks.UNREACHABLE / 2
    # Column 2 has nothing within the cutoff, so -60 stays and -90 goes; in column 0, -50 goes.
    assert is_cut.tolist() == [[False, False, True], [False, False, False], [True, False, False]]


def test_soft_paths_become_shortest_paths_when_the_softmax_is_sharp():
    lengths = np.asarray(jax.random.uniform(jax.random.key(1), (6, 6), minval=1.0, maxval=9.0))
    lengths = lengths * (1.0 - np.eye(6))
    shortest = lengths.copy()
    for k, i, j in itertools.product(range(6), repeat=3):
        shortest[i, j] = min(shortest[i, j], shortest[i, k] + shortest[k, j])
    paths = landmarks.soft_paths(jnp.asarray(-lengths, jnp.float32), 1e3, 4)
    np.testing.assert_allclose(paths, -shortest, rtol=1e-5, atol=1e-5)


def test_a_soft_path_is_no_better_than_the_best_one():
    lengths = jax.random.uniform(jax.random.key(2), (5, 5), minval=1.0, maxval=9.0)
    edges = -lengths * (1.0 - jnp.eye(5))
    soft = landmarks.soft_paths(edges, 0.9, 5)
    hard = landmarks.soft_paths(edges, 1e3, 5)
    assert (np.asarray(soft) <= np.asarray(hard) + 1e-4).all()


def test_waiting_at_a_landmark_costs_nothing():
    """A soft way over any number of near landmarks is hardly longer than the shortest."""
    x = jnp.array([0.0, 0.1, 0.2, 5.0, 10.0, 10.1])
    edges = -jnp.abs(x[:, None] - x[None])
    paths = landmarks.soft_paths(edges, 0.9, higl.Landmarks().rounds)
    np.testing.assert_allclose(paths, edges, atol=1.0)
    assert (jnp.diagonal(paths) == 0.0).all()


@pytest.mark.parametrize("heat", [0.5, 5.0])
def test_joining_is_a_weighted_mean_of_the_ways(heat):
    first, second = jnp.array([[-1.0, -2.0]]), jnp.array([[-3.0], [-1.0]])
    ways = np.array([-4.0, -3.0])
    weight = np.exp(heat * ways) / np.exp(heat * ways).sum()
    joined = landmarks.soft_join(first, second, heat)
    np.testing.assert_allclose(joined, [[weight @ ways]], rtol=1e-5)
