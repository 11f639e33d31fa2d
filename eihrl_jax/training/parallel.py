"""Sharding over devices and hosts: one mesh axis, `shard_map`, JAX's distributed runtime.

On CPU, XLA runs the many small operations of a rollout on one core; with as many CPU devices as
cores (`use_cpu_cores`) every core runs its own share of the workers.
"""

import math
import os
from typing import Any, TypeVar, cast

import jax
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float

from eihrl_jax import base
from eihrl_jax.agents import devices, peg_a2c

OPTIONS = ("num_devices", "coordinator", "num_processes", "process_id")
"""Options that may differ between the processes of a run, and when it goes on."""

# `Any`: a spec stands where the state's annotations have an array.
_ALIKE = cast(Any, PartitionSpec())
_PER_WORKER = cast(Any, PartitionSpec(devices.AXIS))
SPECS = peg_a2c.LearnerState(
    params=_ALIKE,
    opt_state=_ALIKE,
    env_state=_PER_WORKER,
    keys=_PER_WORKER,
    num_updates=_ALIKE,
    num_decisions=_ALIKE,
)
"""Which parts of a learner's state are spread over devices: what belongs to one worker."""

TreeT = TypeVar("TreeT")


def use_cpu_cores() -> None:
    """Makes every core of the CPU a device; only entry points call it, before any computation."""
    # Not every system tells which of its cores are this process's.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    jax.config.update("jax_num_cpu_devices", cores or 1)


def connect(
    coordinator: str | None, num_processes: int | None = None, process_id: int | None = None
) -> None:
    """Joins the processes of one run, on one or several hosts; without coordinator there is one.

    Args:
      coordinator: address and port of process 0, "host:port"; "auto" finds everything in the
        environment of the cluster (Slurm, Open MPI, Cloud TPU, Kubernetes).
      num_processes: processes in all.
      process_id: number of this one, from 0.

    Raises:
      UserError: only part of the options is given, or they contradict each other.
    """
    if coordinator is None:
        if num_processes is not None or process_id is not None:
            raise base.UserError(
                "num_processes and process_id need a coordinator, such as host:1234"
            )
        return

    if coordinator == "auto":
        jax.distributed.initialize()
        return

    if num_processes is None or process_id is None:
        raise base.UserError(f"coordinator = {coordinator!r} needs num_processes and process_id")
    if not 0 <= process_id < num_processes:
        raise base.UserError(
            f"process_id = {process_id} must be in [0, {num_processes}), by num_processes"
        )
    jax.distributed.initialize(coordinator, num_processes, process_id)


def or_one_on_cpu(num_devices: int | None) -> int | None:
    """Returns the number of devices asked for; else 1 on CPU, where a device uses all cores."""
    return num_devices or (1 if jax.default_backend() == "cpu" else None)


def make_mesh(num_devices: int | None, **shared: int) -> jax.sharding.Mesh:
    """Lays the devices of all processes along one axis over which a run's work is spread.

    Args:
      num_devices: devices to use of each process; None: as many as can share the work evenly.
      **shared: what they share, by the name of its option.

    Raises:
      UserError: there are fewer devices, or they can't share the work evenly.
    """
    there, processes = jax.local_device_count(), jax.process_count()
    if num_devices is None:
        common = math.gcd(*shared.values())
        even = [num for num in range(1, there + 1) if common % (num * processes) == 0]
        num_devices = max(even, default=1)
    if num_devices > there:
        raise base.UserError(f"num_devices = {num_devices} must be at most {there}, all there are")
    for name, number in shared.items():
        if number % (num_devices * processes):
            raise base.UserError(
                f"{name} = {number} must be a multiple of the {num_devices * processes} "
                "devices that share them"
            )

    # Process by process, so that a process's workers lie next to each other.
    chosen = [
        device
        for process in range(processes)
        for device in jax.local_devices(process_index=process)[:num_devices]
    ]
    return jax.sharding.Mesh(np.array(chosen), (devices.AXIS,))


def init(agent: peg_a2c.PegA2C, seed: int, mesh: jax.sharding.Mesh) -> peg_a2c.LearnerState:
    """Makes the initial state of a learner, every worker on its device."""
    # Made where they belong, instead of on one device and then spread.
    init = jax.jit(
        lambda: agent.init(jax.random.key(seed)),
        out_shardings=_shardings(mesh),
        compiler_options=base.QUICK_COMPILE,
    )
    return init()


def repeated_update(agent: peg_a2c.PegA2C, num: int, mesh: jax.sharding.Mesh) -> jax.stages.Wrapped:
    """Makes the compiled function of `num` updates.

    Returns:
      A function from a state, which it consumes, to the next one and to metrics with axis `num`.
    """

    def run(
        state: peg_a2c.LearnerState,
    ) -> tuple[peg_a2c.LearnerState, dict[str, Float[Array, " U"]]]:
        return jax.lax.scan(lambda state, _: agent.update(state), state, length=num)

    # Tracking which values differ between devices would ask every environment for carries that
    # say so from the first step; that the parameters stay equal is tested instead.
    sharded = jax.shard_map(
        run, mesh=mesh, in_specs=(SPECS,), out_specs=(SPECS, _ALIKE), check_vma=False
    )
    # Without `out_shardings` a state that comes back looks different from a first one on one
    # device, and everything would be compiled twice.
    shardings = (_shardings(mesh), devices.sharding(mesh))
    return jax.jit(sharded, donate_argnums=0, out_shardings=shardings)


def local(tree: TreeT) -> TreeT:
    """Returns this process's first copy of arrays that are the same everywhere."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def _shardings(mesh: jax.sharding.Mesh) -> peg_a2c.LearnerState:
    return jax.tree.map(
        lambda spec: jax.sharding.NamedSharding(mesh, spec),
        SPECS,
        is_leaf=lambda x: isinstance(x, PartitionSpec),
    )
