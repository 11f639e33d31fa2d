"""Quarter turns against complex multiplication and MuJoCo's own quaternions."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eihrl_jax import base
from eihrl_jax.ops import rotations

ANGLES = (0.0, np.pi, np.pi / 2, -np.pi / 2)


@pytest.mark.parametrize("direction", range(4))
def test_direction_becomes_x_plus(direction):
    unit_xy = jnp.array(base.DIRECTIONS_XY[direction])
    turned = rotations.to_direction_frame(unit_xy, jnp.int32(direction))
    np.testing.assert_allclose(turned, [1.0, 0.0], atol=1e-7)


@pytest.mark.parametrize("direction", range(4))
def test_frames_undo_each_other(direction):
    xy = jnp.array([0.3, -1.7])
    there = rotations.to_direction_frame(xy, jnp.int32(direction))
    back = rotations.to_world_frame(there, jnp.int32(direction))
    np.testing.assert_allclose(back, xy, atol=1e-7)
    as_complex = complex(*xy.tolist()) * np.exp(-1j * ANGLES[direction])
    np.testing.assert_allclose(there, [as_complex.real, as_complex.imag], atol=1e-6)


@pytest.mark.parametrize("direction", range(4))
def test_quaternion_turns_as_in_mujoco(direction):
    quat = np.random.default_rng(direction).normal(size=4)
    quat /= np.linalg.norm(quat)
    turn, expected = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), -ANGLES[direction])
    mujoco.mju_mulQuat(expected, turn, quat)
    found = rotations.quaternion_to_direction_frame(jnp.float32(quat), jnp.int32(direction))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_opposite_quaternions_are_one_posture():
    quat = jnp.array([-0.6, 0.5, -0.4, 0.48])
    np.testing.assert_array_equal(rotations.with_positive_w(quat), -quat)
    np.testing.assert_array_equal(rotations.with_positive_w(-quat), -quat)


@pytest.mark.parametrize("angle", [0.0, 0.4, -2.0, np.pi])
def test_bodies_turn_about_their_own_axis_as_in_mujoco(angle):
    quat = np.random.default_rng(7).normal(size=4)
    quat /= np.linalg.norm(quat)
    turn, expected, heading = np.zeros(4), np.zeros(4), np.zeros(3)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), angle)
    mujoco.mju_mulQuat(expected, quat, turn)
    found = rotations.turn_body(jnp.float32(quat), jnp.float32(angle))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    mujoco.mju_rotVecQuat(heading, np.array([1.0, 0.0, 0.0]), expected)
    np.testing.assert_allclose(rotations.heading(found), heading[:2], atol=1e-6)
    turned = rotations.turn(jnp.array([0.3, -1.7]), jnp.float32(angle))
    as_complex = complex(0.3, -1.7) * np.exp(1j * angle)
    np.testing.assert_allclose(turned, [as_complex.real, as_complex.imag], atol=1e-6)
