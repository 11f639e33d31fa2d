"""MuJoCo's JAX engine: the same model in float32, compiled for the device that JAX uses."""

import contextlib
from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from mujoco import mjx

from eihrl_jax import base
from eihrl_jax.physics import engine, scene
from eihrl_jax.robots import robot as robot_lib


class MjxEngine:
    """`engine.Engine` as a JAX program; contacts of every geom are computed in every step.

    Compiling it takes from half a minute to minutes on a CPU, the longer the more geoms the robot
    has; `mujoco_engine.MujocoEngine` is the faster one there.
    """

    def __init__(self, robot: robot_lib.Robot, *, impl: str = "jax"):
        """Compiles the robot's scene and puts it on the device.

        Args:
          robot: the robot to drive.
          impl: MJX's own implementation, "jax"; or "warp" where the package `warp-lang` and an
            NVIDIA GPU are.

        Raises:
          base.UserError: the robot's MJCF can't be read or compiled, or MJX lacks something that
            it uses.
        """
        self.robot = robot
        self.model = scene.build(robot)
        try:
            self._model = mjx.put_model(self.model, impl=impl)
            self._data = mjx.make_data(self.model, impl=impl)
        except (NotImplementedError, RuntimeError) as error:
            raise base.UserError(f"engine 'mjx' can't run robot {robot.name!r}: {error}") from None

    def step(
        self,
        state: engine.PhysicsState,
        ctrl: Float[Array, " nu"],
        walls_xy: Float[Array, "num_walls 2"],
    ) -> engine.PhysicsState:
        """Advances one control step, see `engine.Engine.step`."""
        mocap_z = self._data.mocap_pos[:, 2:]
        data = self._data.replace(
            qpos=state.qpos,
            qvel=state.qvel,
            qacc_warmstart=state.qacc_warmstart,
            ctrl=ctrl.astype(jnp.float32),
            mocap_pos=jnp.concatenate([walls_xy.astype(jnp.float32), mocap_z], 1),
        )
        with _lenient_promotion():
            data = jax.lax.fori_loop(
                0, self.robot.num_substeps, lambda _, d: mjx.step(self._model, d), data
            )
        stepped = engine.PhysicsState(
            qpos=data.qpos, qvel=data.qvel, qacc_warmstart=data.qacc_warmstart
        )
        is_moving = jnp.isfinite(ctrl).all()
        return jax.tree.map(lambda new, old: jnp.where(is_moving, new, old), stepped, state)


@contextlib.contextmanager
def _lenient_promotion() -> Iterator[None]:
    """Lets MJX, which relies on JAX's default promotions, be traced where they are forbidden."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
