"""What only a simulation tells of a robot: does it do what its description allows?"""

import mujoco
import numpy as np

from eihrl_jax import base
from eihrl_jax.physics import controls, posture, scene
from eihrl_jax.robots import robot as robot_lib

_NUM_STEPS = 100
"""Control steps at full power by which the greatest speed is measured."""

_HELD = 10
"""Control steps for which each of them keeps its direction."""

_TOLERANCE = 1.02
"""How much farther a part may come than the description says."""


def check(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Checks the numbers of a description on which it hangs that walls hold the robot.

    Args:
      model: its scene.
      robot: the description.

    Raises:
      base.UserError: parts of it are farther away, or it is faster, than the description says.
    """
    what = f"robot {robot.name!r}"
    reach = posture.reach(model, robot)
    if reach > _TOLERANCE * robot.reach:
        remedy = f"reach must be {reach:.2f}"
        if reach > robot.cell:
            remedy = f"it needs a cell of more than {reach:.2f}"
        raise base.UserError(
            f"{what}: reach = {robot.reach}, but parts come {reach:.2f} m far from its torso: "
            f"{remedy}"
        )

    speed = top_speed(model, robot)
    if speed * robot.physics_step > robot.body_radius:
        raise base.UserError(
            f"{what}: at full power it moves {speed * robot.physics_step:.2f} m in a physics step, "
            f"farther than its body_radius of {robot.body_radius}: take a smaller physics_step"
        )
    limit = robot.max_travel / robot.units_per_metre / robot.control_step
    if speed > limit:
        raise base.UserError(
            f"{what}: at full power it moves at {speed:.1f} m/s, and walls hold up to {limit:.1f}: "
            f"say max_speed = {1.05 * speed:.1f}, or take fewer num_substeps"
        )


def top_speed(model: mujoco.MjModel, robot: robot_lib.Robot, seed: int = 0) -> float:
    """Returns the torso's greatest mean speed along an axis in a control step at full power, m/s.

    Args:
      model: the robot's scene; walls are far away.
      robot: the description.
      seed: of the controls, each of which is -1 or 1 for a while.
    """
    rng, data, taken = np.random.default_rng(seed), mujoco.MjData(model), controls.of(model)
    data.qpos[:] = model.key_qpos[0]
    data.mocap_pos[:] = (*scene.PARKED_XY, robot.cell / 2)
    greatest = 0.0

    # First all of them forward: those of a cart that steers would turn it on the spot at random.
    ctrl = np.ones(model.nu, np.float32)
    for step in range(_NUM_STEPS):
        before = data.qpos[:2].copy()
        data.ctrl[:] = taken.of(ctrl)
        mujoco.mj_step(model, data, robot.num_substeps)
        path = np.abs(data.qpos[:2] - before).max()
        if not np.isfinite(path):
            break
        greatest = max(greatest, float(path))
        if step % _HELD == _HELD - 1 and step >= _NUM_STEPS // 2:
            ctrl = rng.choice(np.array([-1.0, 1.0], np.float32), model.nu)
    return greatest / robot.control_step
