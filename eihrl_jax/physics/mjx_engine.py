"""MuJoCo's JAX engine: the same model in float32, compiled for the device that JAX uses."""

import contextlib
import threading
from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float
from mujoco import mjx

from eihrl_jax import base
from eihrl_jax.ops import tree
from eihrl_jax.physics import controls, engine, scene
from eihrl_jax.robots import robot as robot_lib

_SMALLEST_TANGENT = 1e-6
"""Capsules closer to vertical than this, in radians, keep MJX's contact frame."""

_CHOLESKY_LOCK = threading.RLock()
"""Held while JAX's factorisation is replaced, which all threads see."""


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

    def step(
        self,
        state: engine.PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
        is_running: Bool[Array, ""] | bool = True,
    ) -> engine.PhysicsState:
        """Advances one control step, see `engine.Engine.step`."""
        scale = self.robot.units_per_metre
        mocap_z = self._data.mocap_pos[:, 2:]  # walls move in the plane only
        data = self._data.replace(
            qpos=state.qpos.at[:2].divide(scale),  # from units to the model's metres
            qvel=state.qvel,
            qacc_warmstart=state.qacc_warmstart,
            ctrl=self._controls.of(ctrl.astype(jnp.float32)),
            mocap_pos=jnp.concatenate([walls_xy.astype(jnp.float32) / scale, mocap_z], 1),
        )

        with _lenient_promotion(), _safe_cholesky():
            data = jax.lax.fori_loop(
                0, self.robot.num_substeps, lambda _, d: self._physics_step(d), data
            )

        stepped = engine.PhysicsState(
            qpos=data.qpos.at[:2].multiply(scale),
            qvel=data.qvel,
            qacc_warmstart=data.qacc_warmstart,
        )
        return tree.where(jnp.asarray(is_running), stepped, state)

    def _physics_step(self, data: mjx.Data) -> mjx.Data:
        """Advances one physics step: `mjx.step`, with contact frames as the C engine has them."""
        data = mjx.fwd_position(self._model, data)
        data = mjx.make_constraint(self._model, _align_with_capsules(self._model, data))
        data = mjx.fwd_velocity(self._model, data)
        data = mjx.fwd_actuation(self._model, data)
        data = mjx.fwd_acceleration(self._model, data)
        data = mjx.solve(self._model, data)
        is_implicit = self._model.opt.integrator == mjx.IntegratorType.IMPLICITFAST
        return (mjx.implicit if is_implicit else mjx.euler)(self._model, data)


def _align_with_capsules(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Turns the contact frames between floor and capsules along the capsules.

    The pyramidal friction cone is stiffer along its edges, so that its orientation matters. MJX
    orients it along the y axis for capsules that are steeper than 60 degrees, the C engine never.
    """
    contact = data._impl.contact
    kinds = jnp.asarray(model.geom_type)[contact.geom]
    is_capsule_on_floor = (kinds[:, 0] == int(mjx.GeomType.PLANE)) & (
        kinds[:, 1] == int(mjx.GeomType.CAPSULE)
    )

    # The capsule's axis without its part along the normal is the first tangent.
    axis = data.geom_xmat[contact.geom[:, 1], :, 2]
    normal = contact.frame[:, 0]
    tangent = axis - (axis * normal).sum(1, keepdims=True) * normal
    length = jnp.linalg.norm(tangent, axis=1, keepdims=True)
    tangent = tangent / jnp.maximum(length, _SMALLEST_TANGENT)
    aligned = jnp.stack([normal, tangent, jnp.cross(normal, tangent)], 1)

    # A capsule that stands upright has no direction on the floor.
    is_turned = is_capsule_on_floor & (length[:, 0] > _SMALLEST_TANGENT)
    frame = jnp.where(is_turned[:, None, None], aligned, contact.frame)
    return data.tree_replace({"_impl.contact.frame": frame})


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
