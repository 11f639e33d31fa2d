"""Quarter turns between the world and the frame of a direction.

The plane of the task maps to itself under quarter turns, so a policy that sees the world turned
such that its subgoal points along x+ needs to learn one direction only.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# Of the angle of each direction, in the order of `base.DIRECTIONS_XY`.
_COS = (1.0, -1.0, 0.0, 0.0)
_SIN = (0.0, 0.0, 1.0, -1.0)


def to_direction_frame(xy: Float[Array, "2"], direction: Int[Array, ""]) -> Float[Array, "2"]:
    """Turns a world vector such that `direction` (0 to 3: x+, x-, y+, y-) becomes x+."""
    cos, sin = jnp.array(_COS)[direction], jnp.array(_SIN)[direction]
    return jnp.stack([cos * xy[0] + sin * xy[1], cos * xy[1] - sin * xy[0]])


def to_world_frame(xy: Float[Array, "2"], direction: Int[Array, ""]) -> Float[Array, "2"]:
    """Undoes `to_direction_frame`."""
    cos, sin = jnp.array(_COS)[direction], jnp.array(_SIN)[direction]
    return jnp.stack([cos * xy[0] - sin * xy[1], sin * xy[0] + cos * xy[1]])


def quaternion_to_direction_frame(
    quat: Float[Array, "4"], direction: Int[Array, ""]
) -> Float[Array, "4"]:
    """Turns an orientation (w, x, y, z) such that `direction` becomes x+."""
    half = jnp.sqrt(0.5)
    # Half-angle cosine and sine of the turn by minus the direction's angle 0, pi, pi/2, -pi/2.
    cos = jnp.array([1.0, 0.0, half, half])[direction]
    sin = -jnp.array([0.0, 1.0, half, -half])[direction]
    w, x, y, z = quat
    return jnp.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w])


def with_positive_w(quat: Float[Array, "4"]) -> Float[Array, "4"]:
    """Returns the one of a quaternion and its negative, the same orientation, that has w >= 0."""
    return jnp.where(quat[0] < 0, -quat, quat)


def up(quat: Float[Array, "4"]) -> Float[Array, ""]:
    """Returns the cosine of a body's tilt: the z component of its own z axis."""
    return 1.0 - 2.0 * (jnp.square(quat[1]) + jnp.square(quat[2]))


def heading(quat: Float[Array, "4"]) -> Float[Array, "2"]:
    """Returns x and y of where an orientation (w, x, y, z) takes the x axis."""
    w, x, y, z = quat
    return jnp.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)])


def turn(xy: Float[Array, "2"], angle: Float[Array, ""]) -> Float[Array, "2"]:
    """Turns a vector by `angle`, radians, counter-clockwise."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([cos * xy[0] - sin * xy[1], sin * xy[0] + cos * xy[1]])


def turn_body(quat: Float[Array, "4"], angle: Float[Array, ""]) -> Float[Array, "4"]:
    """Turns an orientation (w, x, y, z) by `angle`, radians, about its own z axis."""
    cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
    w, x, y, z = quat
    # The turn stands on the right of the product: it is one about the body's axis.
    return jnp.stack([cos * w - sin * z, cos * x + sin * y, cos * y - sin * x, cos * z + sin * w])
