"""Contacts of MJX's scenes: those that can't be are left out before they cost anything.

A robot of G geoms near W walls has up to 2 G (W + 1) contacts, a hundred of the ant's, of which few
ever are: ten in the C engine, among ants that tumble through a narrow corridor. MJX computes forces
for every one that it is given.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from mujoco import mjx

# MJX's own driver has a broad phase by bounding spheres: in it the nearest wall of a limb may well
# be none of those that are kept, a wall's sphere being much larger than the wall.
from mujoco.mjx._src import collision_driver

from eihrl_jax.physics import scene

MAX_WALL_PAIRS = 8
"""Geoms of a kind and walls, whose contact is computed: the nearest ones."""

_SMALLEST_TANGENT = 1e-6
"""Capsules closer to vertical than this, in radians, keep MJX's contact frame."""


class Collision(NamedTuple):
    """What `collide` finds.

    Attributes:
      data: with its contacts.
      num_dropped: int32, contacts that were left out, and pairs that were close enough to have one.
    """

    data: mjx.Data
    num_dropped: Int[Array, ""]


def collide(model: mjx.Model, data: mjx.Data, is_wall: np.ndarray) -> Collision:
    """Finds contacts of a robot in its position, as `mjx.collision` does, but only likely ones.

    Args:
      model: of a scene, see `scene.MAX_CONTACTS`.
      data: with positions of all geoms.
      is_wall: bool [ngeom], which geoms are walls: boxes that stand along the axes.
    """
    num_dropped, by_dimension = jnp.int32(0), {}
    pairs = collision_driver._geom_groups(model)
    for key, contact in collision_driver._contact_groups(model, data).items():
        geoms = np.array(pairs[key])[:, :2]
        if is_wall[geoms].any() and len(geoms) > MAX_WALL_PAIRS:
            gaps = _gaps(model, data, geoms, is_wall)
            contact, dropped = _nearest(contact, gaps, MAX_WALL_PAIRS)
            num_dropped += dropped

        # A function may return several contacts of each pair.
        first, second = (mjx.GeomType(int(kind)) for kind in key.types)
        find = collision_driver._COLLISION_FUNC[first, second]
        dist, pos, frame = find(model, data, key, contact.geom)
        contact = jax.tree.map(lambda leaf, n=find.ncon: jnp.repeat(leaf, n, 0), contact)
        contact = contact.replace(dist=dist, pos=pos, frame=frame)
        by_dimension.setdefault(key.condim, []).append(contact)

    kept = []
    for dimension in sorted(by_dimension):
        contact = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *by_dimension[dimension])
        if len(contact.dist) > scene.MAX_CONTACTS:
            above = contact.dist - contact.includemargin
            contact, dropped = _nearest(contact, above, scene.MAX_CONTACTS)
            num_dropped += dropped
        kept.append(contact)
    if not kept:
        return Collision(data, num_dropped)

    contact = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *kept)
    data = data.tree_replace({"_impl.contact": contact})
    return Collision(_align_with_capsules(model, data), num_dropped)


def _nearest(
    contact: mjx.Contact, gaps: Float[Array, " P"], num: int
) -> tuple[mjx.Contact, Int[Array, ""]]:
    """Returns those of some contacts whose gaps are smallest, and how many touching ones aren't."""
    chosen = jax.lax.top_k(-gaps, num)[1]
    kept = jax.tree.map(lambda leaf: leaf[chosen], contact)
    return kept, jnp.maximum((gaps < 0.0).sum() - num, 0)


def _gaps(
    model: mjx.Model, data: mjx.Data, geoms: np.ndarray, is_wall: np.ndarray
) -> Float[Array, " P"]:
    """Returns how far geoms are from walls at least, metres; negative where they may touch."""
    # Some kinds of a robot's geoms come behind boxes in a pair.
    walls = np.where(is_wall[geoms[:, 0]], geoms[:, 0], geoms[:, 1])
    others = np.where(is_wall[geoms[:, 0]], geoms[:, 1], geoms[:, 0])

    # Half the sides of a box along the axes that a geom fits into.
    radius, half_length = model.geom_size[others, 0], model.geom_size[others, 1]
    axis = jnp.abs(data.geom_xmat[others, :, 2])
    capsule = axis * half_length[:, None] + radius[:, None]
    is_capsule = model.geom_type[others] == int(mjx.GeomType.CAPSULE)
    extent = jnp.where(is_capsule[:, None], capsule, model.geom_rbound[others][:, None])

    away = jnp.abs(data.geom_xpos[others] - data.geom_xpos[walls])
    return (away - model.geom_size[walls] - extent).max(1)


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
