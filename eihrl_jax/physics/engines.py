"""Both physics engines by name."""

import contextlib
import io

from eihrl_jax import base, robots
from eihrl_jax.physics import engine, mujoco_engine, trials
from eihrl_jax.robots import robot as robot_lib


def make(robot: robot_lib.Robot, name: str = "mujoco", cell: float | None = None) -> engine.Engine:
    """Returns an engine for a robot.

    Args:
      robot: the robot to drive.
      name: "mujoco" for the C engine on the processor's cores, "mjx" for JAX.
      cell: side of a wall's box, metres; None: the robot's cell.

    Raises:
      base.UserError: the engine is unknown, or walls wouldn't hold the robot.
    """
    if name == "mujoco":
        return _checked(mujoco_engine.MujocoEngine(robot, cell))
    if name == "mjx":
        # Without Warp, which only its other implementation needs, MJX prints that it is missing.
        with contextlib.redirect_stdout(io.StringIO()):
            from eihrl_jax.physics import mjx_engine  # A second to import, and mostly not needed.

        return _checked(mjx_engine.MjxEngine(robot, cell))
    raise base.UserError(f"engine {name!r} is unknown; choose one of {', '.join(base.ENGINES)}")


def _checked(made: engine.Engine) -> engine.Engine:
    """Returns an engine; of a robot that isn't the package's own only after a trial."""
    if made.robot.mjcf.parent != robots.ASSETS:
        trials.check(made.model, made.robot)
    return made
