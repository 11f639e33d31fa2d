"""MuJoCo's C engine, batched over a thread pool and called from inside compiled JAX programs."""

import functools
import hashlib
import threading
import weakref
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float
from mujoco import batch as mujoco_batch

from eihrl_jax.physics import controls, engine, host_call, scene
from eihrl_jax.robots import robot as robot_lib


class MujocoEngine:
    """`engine.Engine` on the processor's cores; float64 inside, float32 at its boundary.

    Programs that step it are kept by JAX's persistent cache, see `host_call`.
    """

    def __init__(self, robot: robot_lib.Robot, cell: float | None = None):
        """Compiles the robot's scene with walls of `cell` metres, by default the robot's cell.

        Raises:
          base.UserError: the robot's MJCF can't be read or compiled.
        """
        self.robot = robot
        self.model = scene.build(robot, cell)
        self._target = _target(self.model, robot)
        self._simulations = _SIMULATIONS.setdefault(self._target, _Simulations(self.model, robot))
        host_call.register(self._target, functools.partial(_step, self._target))

    def step(
        self,
        state: engine.PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
        is_running: Bool[Array, ""] | bool = True,
    ) -> engine.PhysicsState:
        """Advances one control step, see `engine.Engine.step`."""
        fields = state.qpos, state.qvel, state.qacc_warmstart
        arguments = *fields, ctrl, walls_xy, jnp.asarray(is_running)
        stepped = host_call.call(
            self._target,
            self._simulations.step,
            [jax.ShapeDtypeStruct(field.shape, jnp.float32) for field in fields],
            arguments,
        )
        return engine.PhysicsState(*stepped)


class _Simulations:
    """Steps robots of one model, batched.

    A call holds nothing over to the next: states are rows that are loaded, stepped and read back,
    so results depend neither on the batch nor on the number of threads.
    """

    def __init__(self, model: mujoco.MjModel, robot: robot_lib.Robot):
        self._model = model
        self._robot = robot
        self._controls = controls.of(model, robot)
        self._batches: dict[int, mujoco_batch.Batch] = {}
        self._lock = threading.Lock()  # JAX may run two programs at once

    def step(self, arguments: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> None:
        """Steps every row of arrays with any leading axes, one caller at a time.

        Args:
          arguments: qpos, qvel, qacc_warmstart, ctrl, walls_xy and is_running.
          results: the first three, which are filled.
        """
        *state, ctrl, walls_xy, is_running = arguments
        with self._lock:
            rows = self._batch(is_running.size)
            fields = [rows.bind(name) for name in ("qpos", "qvel", "qacc_warmstart")]
            for view, values in zip(fields, state, strict=True):
                view[...] = values.reshape(view.shape)

            # From units to the model's metres, and back at the end.
            qpos, scale = fields[0], self._robot.units_per_metre
            qpos[..., :2] /= scale
            walls_metres = walls_xy / np.float32(scale)
            rows.bind("mocap_pos")[..., :2] = walls_metres.reshape(rows.nsim, -1, 2)
            ctrls, running = ctrl.reshape(rows.nsim, -1), is_running.ravel()

            # MuJoCo would take controls that are no numbers for zeros, and warn on the terminal.
            is_number = np.isfinite(ctrls).all(1)
            qpos[running & ~is_number] = np.nan
            moving = np.flatnonzero(running & is_number)
            rows.bind("ctrl")[moving] = self._controls.of(ctrls[moving])

            try:
                rows.step(ids=moving, nstep=self._robot.num_substeps)
            except mujoco_batch.SimulationError as error:
                qpos[error.ids] = np.nan  # the environment's guard ends these episodes
            qpos[..., :2] *= scale
            for result, view in zip(results, fields, strict=True):
                result[...] = view.reshape(result.shape)

    def _batch(self, num_rows: int) -> mujoco_batch.Batch:
        """Returns the simulations for `num_rows` rows, made on first use."""
        if num_rows not in self._batches:
            rows = mujoco_batch.Batch(self._model, num_rows)
            wall = self._model.body(scene.wall_name(0)).id
            rows.bind("mocap_pos")[..., 2] = self._model.body_pos[wall, 2]
            self._batches[num_rows] = rows
        return self._batches[num_rows]


_SIMULATIONS: weakref.WeakValueDictionary[str, _Simulations] = weakref.WeakValueDictionary()
"""By the name that compiled programs know; engines of the same model share one."""


def _step(target: str, arguments: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> None:
    """Steps robots by the name of their simulations, which some engine holds."""
    _SIMULATIONS[target].step(arguments, results)


def _target(model: mujoco.MjModel, robot: robot_lib.Robot) -> str:
    """Returns a name that stands for all that a step depends on, the same in every process."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    ranges = f"{robot.servo_range!r} {robot.recovery_range!r}"
    numbers = f"{robot.units_per_metre!r} {robot.num_substeps} {ranges}"
    return f"eihrl_jax.step.{hashlib.sha256(content.tobytes() + numbers.encode()).hexdigest()}"
