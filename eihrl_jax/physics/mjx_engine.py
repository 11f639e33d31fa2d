"""MuJoCo's JAX engine: the same model in float32, compiled for the device that JAX uses."""

import contextlib
import threading
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from mujoco import mjx

from eihrl_jax import base
from eihrl_jax.ops import tree
from eihrl_jax.physics import controls, engine, mjx_contacts, mjx_solver, scene
from eihrl_jax.robots import robot as robot_lib

_CHOLESKY_LOCK = threading.RLock()
"""Held while JAX's factorisation is replaced, which all threads see."""

_VELOCITY = 2  # the parameter of an actuator that multiplies its velocity


class MjxEngine:
    """`engine.Engine` as a JAX program; contacts of every geom are computed in every step.

    Compiling it takes from half a minute to minutes on a CPU, the longer the more geoms the robot
    has; `mujoco_engine.MujocoEngine` is the faster one there.
    """

    def __init__(self, robot: robot_lib.Robot, cell: float | None = None):
        """Compiles the robot's scene and puts it on the device.

        Args:
          robot: the robot to drive.
          cell: side of a wall's box, metres; None: the robot's cell.

        Raises:
          base.UserError: the robot's MJCF can't be read or compiled, or MJX lacks something that
            it uses.
        """
        self.robot = robot
        self.model = scene.build(robot, cell)
        self._controls = controls.of(self.model, robot)
        try:
            self._model = mjx.put_model(self.model, impl="jax")
            self._data = mjx.make_data(self.model, impl="jax")
        except (NotImplementedError, RuntimeError) as error:
            raise base.UserError(f"engine 'mjx' can't run robot {robot.name!r}: {error}") from None

        walls = [self.model.geom(scene.wall_name(index)).id for index in range(robot.num_walls)]
        self._is_wall = np.isin(np.arange(self.model.ngeom), walls)
        self._solve = mjx_solver.solve if mjx_solver.is_suited(self.model) else mjx.solve

    def step(
        self,
        state: engine.PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
        is_running: Bool[Array, ""] | bool = True,
    ) -> engine.PhysicsState:
        """Advances one control step, see `engine.Engine.step`."""
        data = self._placed(state, walls_xy)
        data = data.replace(ctrl=self._controls.of(ctrl.astype(jnp.float32)))

        with _lenient_promotion(), _safe_cholesky():
            data = jax.lax.fori_loop(
                0, self.robot.num_substeps, lambda _, d: self._physics_step(d), data
            )

        stepped = engine.PhysicsState(
            qpos=data.qpos.at[:2].multiply(self.robot.units_per_metre),
            qvel=data.qvel,
            qacc_warmstart=data.qacc_warmstart,
        )
        return tree.where(jnp.asarray(is_running), stepped, state)

    def num_dropped(
        self, state: engine.PhysicsState, walls_xy: Float[Array, "num_walls 2"]
    ) -> Int[Array, ""]:
        """Returns how many contacts a step from this state leaves out, see `mjx_contacts`."""
        with _lenient_promotion():
            data = mjx.kinematics(self._model, self._placed(state, walls_xy))
            return mjx_contacts.collide(self._model, data, self._is_wall).num_dropped

    def _placed(
        self, state: engine.PhysicsState, walls_xy: Float[Array, "num_walls 2"]
    ) -> mjx.Data:
        """Returns the model's data with robot and walls where they are."""
        scale = self.robot.units_per_metre
        mocap_z = self._data.mocap_pos[:, 2:]  # walls move in the plane only
        return self._data.replace(
            qpos=state.qpos.at[:2].divide(scale),  # from units to the model's metres
            qvel=state.qvel,
            qacc_warmstart=state.qacc_warmstart,
            mocap_pos=jnp.concatenate([walls_xy.astype(jnp.float32) / scale, mocap_z], 1),
        )

    def _physics_step(self, data: mjx.Data) -> mjx.Data:
        """Advances one physics step, as `mjx.step` does, with contacts and solver of our own."""
        model = self._model
        for compute in (mjx.kinematics, mjx.com_pos, mjx.tendon, mjx.crb):
            data = compute(model, data)
        data = mjx.factor_m(model, mjx.tendon_armature(model, data))
        data = mjx_contacts.collide(model, data, self._is_wall).data
        data = mjx.make_constraint(model, data)
        data = mjx.transmission(model, data)

        for compute in (mjx.fwd_velocity, mjx.fwd_actuation, mjx.fwd_acceleration, self._solve):
            data = compute(model, data)
        if model.opt.integrator != mjx.IntegratorType.IMPLICITFAST:
            return mjx.euler(model, data)
        return mjx.implicit(_without_spent_damping(model, data), data)


def _without_spent_damping(model: mjx.Model, data: mjx.Data) -> mjx.Model:
    """Returns the model without the damping of actuators that are at the limit of their force.

    Their force doesn't change with velocity, which the C engine knows when it integrates and MJX
    doesn't: a Go1's hip, thrown to and fro, was 0.013 rad off after one control step.
    """
    low, high = model.actuator_forcerange.T
    is_spent = (data.actuator_force <= low) | (data.actuator_force >= high)
    is_spent &= jnp.asarray(model.actuator_forcelimited, bool)

    def left(parameters: Array) -> Array:
        return parameters.at[:, _VELOCITY].multiply(jnp.where(is_spent, 0.0, 1.0))

    return model.replace(
        actuator_gainprm=left(model.actuator_gainprm), actuator_biasprm=left(model.actuator_biasprm)
    )


@contextlib.contextmanager
def _lenient_promotion() -> Iterator[None]:
    """Lets MJX, which relies on JAX's default promotions, be traced where they are forbidden."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@contextlib.contextmanager
def _safe_cholesky() -> Iterator[None]:
    """Lets MJX be traced without LAPACK's Cholesky on a CPU, which may wait forever.

    jaxlib before 0.11.2 divides a large batch among the threads of its pool, and one of them waits
    for the others; as many factorisations at once as there are threads wait for each other. The
    mass matrix of the implicit integrator and that of the forward dynamics are such: 256 ants on
    two cores hung.
    """
    if jax.default_backend() != "cpu":
        yield
        return
    with _CHOLESKY_LOCK:
        original = jax.scipy.linalg.cho_factor
        jax.scipy.linalg.cho_factor = _cho_factor
        try:
            yield
        finally:
            jax.scipy.linalg.cho_factor = original


def _cho_factor(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], bool]:
    """`jax.scipy.linalg.cho_factor` of a real matrix, column by column in JAX; its upper factor."""
    rows = jnp.arange(len(matrix))

    def fill(k: Array, lower: Float[Array, "n n"]) -> Float[Array, "n n"]:
        column = matrix[:, k] - lower @ lower[k]
        return lower.at[:, k].set(jnp.where(rows < k, 0.0, column / jnp.sqrt(column[k])))

    return jax.lax.fori_loop(0, len(matrix), fill, jnp.zeros_like(matrix)).T, False
