"""MuJoCo's C engine, batched over a thread pool and called from inside compiled JAX programs."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from mujoco import batch as mujoco_batch

from eihrl_jax.physics import controls, engine, scene
from eihrl_jax.robots import robot as robot_lib


class MujocoEngine:
    """`engine.Engine` on the processor's cores; float64 inside, float32 at its boundary.

    A call holds nothing over to the next: states are rows that are loaded, stepped and read back,
    so results depend neither on the batch nor on the number of threads.
    """

    def __init__(self, robot: robot_lib.Robot, cell: float | None = None):
        """Compiles the robot's scene with walls of `cell` metres, by default the robot's cell.

        Raises:
          base.UserError: the robot's MJCF can't be read or compiled.
        """
        self.robot = robot
        self.model = scene.build(robot, cell)
        self._controls = controls.of(self.model)
        self._batches: dict[int, mujoco_batch.Batch] = {}
        self._lock = threading.Lock()  # JAX may run two programs' callbacks at once

    def step(
        self,
        state: engine.PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
        is_running: Bool[Array, ""] | bool = True,
    ) -> engine.PhysicsState:
        """Advances one control step, see `engine.Engine.step`."""
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, jnp.float32), state)
        return jax.pure_callback(
            self._step_rows,
            shapes,
            state,
            ctrl,
            walls_xy,
            jnp.asarray(is_running),
            vmap_method="broadcast_all",
        )

    def _step_rows(
        self, state: engine.PhysicsState, ctrl: Array, walls_xy: Array, is_running: Array
    ) -> engine.PhysicsState:
        """Steps every row of arrays with any leading axes, on the host, one caller at a time."""
        with self._lock:
            lead = state.qpos.shape[:-1]
            rows = self._batch(int(np.prod(lead)))

            # NumPy from here on: indexing a JAX array would compile anew for every number of rows.
            fields = ("qpos", "qvel", "qacc_warmstart")
            for name in fields:
                view = rows.bind(name)
                view[...] = np.asarray(getattr(state, name)).reshape(view.shape)
            # From units to the model's metres, and back at the end.
            rows.bind("qpos")[..., :2] /= self.robot.units_per_metre
            walls_metres = np.asarray(walls_xy) / np.float32(self.robot.units_per_metre)
            rows.bind("mocap_pos")[..., :2] = walls_metres.reshape(rows.nsim, -1, 2)
            ctrls, running = np.asarray(ctrl).reshape(rows.nsim, -1), np.asarray(is_running).ravel()

            # MuJoCo would take controls that are no numbers for zeros, and warn on the terminal.
            is_number = np.isfinite(ctrls).all(1)
            rows.bind("qpos")[running & ~is_number] = np.nan
            moving = np.flatnonzero(running & is_number)
            rows.bind("ctrl")[moving] = self._controls.of(ctrls[moving])

            try:
                rows.step(ids=moving, nstep=self.robot.num_substeps)
            except mujoco_batch.SimulationError as error:
                rows.bind("qpos")[error.ids] = np.nan  # the environment's guard ends these episodes
            rows.bind("qpos")[..., :2] *= self.robot.units_per_metre
            return state.replace(**{name: _as_float32(rows.bind(name), lead) for name in fields})

    def _batch(self, num_rows: int) -> mujoco_batch.Batch:
        """Returns the simulations for `num_rows` rows, made on first use."""
        if num_rows not in self._batches:
            rows = mujoco_batch.Batch(self.model, num_rows)
            wall = self.model.body(scene.wall_name(0)).id
            rows.bind("mocap_pos")[..., 2] = self.model.body_pos[wall, 2]
            self._batches[num_rows] = rows
        return self._batches[num_rows]


def _as_float32(rows: np.ndarray, lead: tuple[int, ...]) -> np.ndarray:
    """Copies rows out of the simulations, with the caller's leading axes."""
    return rows.astype(np.float32).reshape(*lead, rows.shape[-1])
