"""Controls in [-1, 1] and what a robot's actuators take: -1 and 1 are the ends of their ranges.

Only a robot that gets up may ask servos for more, up to `robot.recovery_scale`.

0 is rest: the middle of a motor's range, and the start posture for a servo, whose halves may then
be of different length.
"""

from typing import NamedTuple, TypeVar, cast

import mujoco
import numpy as np
from jaxtyping import Array, Float

from eihrl_jax.robots import robot as robot_lib

ArrayT = TypeVar("ArrayT", np.ndarray, Array)


class Controls(NamedTuple):
    """The map of a model that `fit` has fitted. nu: number of actuators.

    Attributes:
      low: float32 [nu], what -1 is to each actuator.
      rest: float32 [nu], what 0 is.
      high: float32 [nu], what 1 is.
      limit: greatest control; beyond 1 where a robot may ask for more when it gets up, of which
        the engine takes what the actuator's whole range allows.
    """

    low: Float[np.ndarray, " nu"]
    rest: Float[np.ndarray, " nu"]
    high: Float[np.ndarray, " nu"]
    limit: float = 1.0

    def of(self, ctrl: ArrayT) -> ArrayT:
        """Returns what controls [..., nu] are to the actuators; NaN stays NaN."""
        up, down = ctrl.clip(0.0, self.limit), ctrl.clip(-self.limit, 0.0)
        taken = self.rest + up * (self.high - self.rest) + down * (self.rest - self.low)
        return cast(ArrayT, taken)


def of(model: mujoco.MjModel, robot: robot_lib.Robot) -> Controls:
    """Returns the map of a model that `fit` has fitted to a robot's description."""
    rest, (low, high) = model.key_ctrl[0].copy(), model.actuator_ctrlrange.T.copy()
    if robot.servo_range is not None:
        is_servo = np.array([_is_servo(model, index) for index in range(model.nu)])
        low[is_servo] = np.maximum(low, rest - robot.servo_range)[is_servo]
        high[is_servo] = np.minimum(high, rest + robot.servo_range)[is_servo]
    ends = (each.astype(np.float32) for each in (low, rest, high))
    return Controls(*ends, limit=robot.recovery_scale)


def fit(model: mujoco.MjModel, robot: robot_lib.Robot) -> None:
    """Gives every actuator a range, and the keyframe the controls at rest.

    Args:
      model: compiled, its keyframe the start posture; changed in place.
      robot: the description.

    Raises:
      ValueError: an actuator has a state or no range; in one line.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    mujoco.mj_fwdPosition(model, data)

    for index in range(model.nu):
        what = f"actuator {model.actuator(index).name or index!r}"
        if model.actuator_dyntype[index] != mujoco.mjtDyn.mjDYN_NONE:
            raise ValueError(f"{what} has a state of its own (dyntype): use a motor or a servo")
        low, high = _range(model, index)
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError(f"{what} has no range: give it a ctrlrange")

        rest = (low + high) / 2
        gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
        if _is_servo(model, index):
            # Where it holds the start posture: there its force is zero.
            rest = -(bias[0] + bias[1] * data.actuator_length[index]) / gain[0]
            rest = min(max(rest, low), high)
            farthest = robot.recovery_range or robot.servo_range
            if farthest is not None:
                low, high = max(low, rest - farthest), min(high, rest + farthest)

        model.actuator_ctrllimited[index] = 1
        model.actuator_ctrlrange[index] = low, high
        model.key_ctrl[0, index] = rest


def _is_servo(model: mujoco.MjModel, index: int) -> bool:
    """Returns whether an actuator's force falls with its position, so that it holds one."""
    is_affine = model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(
        is_affine and model.actuator_biasprm[index, 1] != 0 and model.actuator_gainprm[index, 0]
    )


def _range(model: mujoco.MjModel, index: int) -> tuple[float, float]:
    """Returns an actuator's range of controls: its own, or else the one that limits imply."""
    if model.actuator_ctrllimited[index]:
        low, high = map(float, model.actuator_ctrlrange[index])
        return low, high

    # A servo that is asked for more than the joint allows only presses against the joint's end.
    joint = model.actuator_trnid[index, 0]
    is_joint = model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_JOINT
    gear, gain = model.actuator_gear[index, 0], model.actuator_gainprm[index, 0]
    if _is_servo(model, index):
        if is_joint and model.jnt_limited[joint]:
            low, high = sorted(float(gear * end) for end in model.jnt_range[joint])
            return low, high
        return np.nan, np.nan

    if model.actuator_forcelimited[index] and gain:
        low, high = sorted(float(end / gain) for end in model.actuator_forcerange[index])
        return low, high
    if is_joint and model.jnt_actfrclimited[joint] and gain * gear:
        low, high = sorted(float(end / (gain * gear)) for end in model.jnt_actfrcrange[joint])
        return low, high
    return np.nan, np.nan
