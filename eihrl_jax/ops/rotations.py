"""Quarter turns between the world and the frame of a direction.

The plane of the task maps to itself under quarter turns, so a policy that sees the world turned
such that its subgoal points along x+ needs to learn one direction only.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

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
    """Turns an orientation (w, x, y, z) such that `direction` becomes x+; w is kept >= 0.

    A quaternion and its negative are one orientation; the sign is fixed so that the policy sees
    one number for one posture.
    """
    half = jnp.sqrt(0.5)
    # Half-angle cosine and sine of the turn by minus the direction's angle 0, pi, pi/2, -pi/2.
    cos = jnp.array([1.0, 0.0, half, half])[direction]
    sin = -jnp.array([0.0, 1.0, half, -half])[direction]
    w, x, y, z = quat
    turned = jnp.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w])
    return jnp.where(turned[0] < 0, -turned, turned)
