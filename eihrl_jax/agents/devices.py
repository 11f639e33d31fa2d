"""Sharding of arrays over the devices of one mesh axis, by workers, robots or batches."""

from collections.abc import Callable
from typing import TypeVar

import jax
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from eihrl_jax.agents import replay

AXIS = "workers"
"""Name of the mesh axis."""

OutT = TypeVar("OutT")
TreeT = TypeVar("TreeT")


def over_devices(function: Callable[..., OutT], mesh: Mesh | None) -> Callable[..., OutT]:
    """Returns a function whose arguments and results are sharded by their leading axes."""
    if mesh is None or mesh.size == 1:
        return function
    spec = PartitionSpec(AXIS)
    return jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)


def sharding(mesh: Mesh, axis: int | None = None) -> NamedSharding:
    """Returns the sharding of an array.

    Args:
      mesh: devices along the axis `AXIS`.
      axis: the array's axis that is sharded; None: it is replicated.
    """
    spec = PartitionSpec() if axis is None else PartitionSpec(*[None] * axis, AXIS)
    return NamedSharding(mesh, spec)


def shard(tree: TreeT, axis: int, mesh: Mesh | None) -> TreeT:
    """Constrains arrays to be sharded by an axis, whose length the devices must divide."""
    if mesh is None or mesh.size == 1:
        return tree
    return jax.lax.with_sharding_constraint(tree, sharding(mesh, axis))


def shardings(state: PyTree, mesh: Mesh) -> PyTree:
    """Returns the shardings of a learner's state: each robot and its stored steps on one device.

    Args:
      state: real or abstract, its environments `envs` with leading axis N.
      mesh: devices along the axis `AXIS`.
    """
    alike, by_robot, by_stream = (sharding(mesh, axis) for axis in (None, 0, 1))

    def place(part: replay.Replay | jax.Array | jax.ShapeDtypeStruct) -> PyTree:
        if isinstance(part, replay.Replay):
            return part.replace(rows=by_stream, position=alike, size=alike)
        return alike

    there = jax.tree.map(place, state, is_leaf=lambda part: isinstance(part, replay.Replay))
    return there.replace(envs=jax.tree.map(lambda _: by_robot, state.envs))
