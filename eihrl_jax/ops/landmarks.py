"""HIGL's choice of landmarks: points spread over a cloud, and soft shortest paths among them.

Kim et al. 2021, Landmark-guided subgoal generation in hierarchical reinforcement learning, Sec. 4.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

UNREACHABLE = -1e6
"""Added to edges that are cut, units of value."""


def farthest_points(xy: Float[Array, "P 2"], num: int) -> Int[Array, " num"]:
    """Picks points one by one, each the farthest from those picked before; the first one first.

    Source: HIGL, Sec. 4.1 (farthest point sampling).
    """

    def body(nearest: Float[Array, " P"], _: None) -> tuple[Float[Array, " P"], Int[Array, ""]]:
        # All distances are infinite at first, so that the first point is picked first.
        index = jnp.argmax(nearest)
        distance = jnp.square(xy - xy[index][None]).sum(-1)
        return jnp.minimum(nearest, distance), index.astype(jnp.int32)

    return jax.lax.scan(body, jnp.full(xy.shape[0], jnp.inf), length=num)[1]


def cut_edges(
    values: Float[Array, "L T"], cutoff: float, self_column: Int[Array, " L"] | None = None
) -> Float[Array, "L T"]:
    """Cuts the edges that are too long for one subgoal.

    Each target keeps its best incoming edge, however long it is.

    Args:
      values: value of the way from each landmark to each target, about minus its length.
      cutoff: least value of an edge that stays.
      self_column: column of each landmark itself, whose edge is 0; None: landmarks aren't targets.

    Returns:
      The same with `UNREACHABLE` added to what is cut.

    Source: HIGL's released code.
    """
    own = jnp.zeros(values.shape, bool)
    if self_column is not None:
        own = own.at[jnp.arange(values.shape[0]), self_column].set(True)
    # No target is cut off: else a sparse cloud would leave the graph in pieces.
    best = jnp.where(own, -jnp.inf, values).max(0)
    is_cut = values < jnp.minimum(best, cutoff)[None]
    return jnp.where(own, 0.0, values + jnp.where(is_cut, UNREACHABLE, 0.0))


def soft_paths(edges: Float[Array, "L L"], heat: float, rounds: int) -> Float[Array, "L L"]:
    """Values of the soft best paths between landmarks, up to 2^rounds edges long.

    Staying at a landmark costs nothing: a soft path loses value with every edge, waiting included,
    and after many doublings the best path would lead by the landmark that loses least.

    Args:
      edges: values of the edges, 0 on the diagonal.
      heat: inverse temperature of the softmax over landmarks on the way.
      rounds: of doubling the paths' lengths.

    Source: HIGL's released code, where the goal's own edge is what stays 0.
    """
    own = jnp.eye(edges.shape[0], dtype=bool)

    def double(paths: Float[Array, "L L"], _: None) -> tuple[Float[Array, "L L"], None]:
        # Like squaring a matrix: each pass joins two paths of the length so far.
        return jnp.where(own, 0.0, soft_join(paths, paths, heat)), None

    return jax.lax.scan(double, edges, length=rounds)[0]


def soft_join(
    first: Float[Array, "L M"], second: Float[Array, "M T"], heat: float
) -> Float[Array, "L T"]:
    """Joins paths at every landmark k: sum_k softmax_k(heat (f_ik + s_kj)) (f_ik + s_kj)."""
    joined = first[:, :, None] + second[None]
    return (jax.nn.softmax(heat * joined, axis=1) * joined).sum(1)
