"""Both physics engines by name."""

from eihrl_jax import base
from eihrl_jax.physics import engine, mujoco_engine
from eihrl_jax.robots import robot as robot_lib


def make(robot: robot_lib.Robot, name: str = "mujoco", cell: float | None = None) -> engine.Engine:
    """Returns an engine for a robot.

    Args:
      robot: the robot to drive.
      name: "mujoco" for the C engine on the processor's cores, "mjx" for JAX.
      cell: side of a wall's box, metres; None: the robot's cell.

    Raises:
      base.UserError: the engine is unknown.
    """
    if name == "mujoco":
        return mujoco_engine.MujocoEngine(robot, cell)
    if name == "mjx":
        from eihrl_jax.physics import mjx_engine  # A second to import, and mostly not needed.

        return mjx_engine.MjxEngine(robot, cell)
    raise base.UserError(f"engine {name!r} is unknown; choose one of {', '.join(base.ENGINES)}")
