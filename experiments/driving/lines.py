"""Collision checks along lines: clearance of a footprint that drives straight or along an arc."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax.robot.driving.footprint import BlockedCells, clearance

#: Clearance kept beyond the footprint, meters: more than rounding errors in single precision on the largest maps.
ROUNDING = 1e-3

#: Number of pieces of a straight line between the points at which its clearance is computed.
_PROBES = 10


def free_straight(
    position: Float[Array, "2"], offsets: Float[Array, "n 2"], around: BlockedCells, radius: float
) -> Bool[Array, "n"]:
    """Whether the footprint stays clear of blocked cells along straight lines from one place to others.

    Args:
      position: start of the lines, meters.
      offsets: offsets of the ends from the start, meters.
      around: blocked cells, complete at least as far as the ends.
      radius: radius of the footprint, meters.
    """
    shares = (jnp.arange(_PROBES + 1) / _PROBES)[:, None, None]
    clear = clearance(position + shares * offsets, around)
    needed = needed_clearance(radius, jnp.linalg.norm(offsets, axis=-1) / _PROBES, 0.0, clear[0, 0])
    return jnp.all(clear >= needed, axis=0)


def needed_clearance(
    radius: float, traveled: Float[Array, "*n"], turned: Float[Array, "*n"] | float, now: Float[Array, "..."]
) -> Float[Array, "*n"]:
    """The clearance at both ends of an arc that guarantees a clear footprint along the whole arc, meters.

    No point of the arc is farther from its chord than an eighth of the arc's length times its turn. No point of the
    chord is farther from the nearer end than half the chord's length.

    Args:
      radius: radius of the footprint, meters.
      traveled: length of the arc, meters.
      turned: turn of the arc, radians.
      now: clearance at the vehicle's current position. If the footprint already touches blocked ground, because that
        ground has just been found to be blocked, the footprint must not go deeper into it. So the vehicle can get away.
    """
    bulge = traveled * jnp.abs(turned) / 8
    needed = jnp.sqrt((radius + ROUNDING + bulge) ** 2 + (traveled / 2) ** 2)
    return jnp.where(now < radius, jnp.minimum(needed, now), needed)


def distance_to_segment(
    point: Float[Array, "2"], begin: Float[Array, "2"], offset: Float[Array, "2"]
) -> Float[Array, ""]:
    """Distance of a point to the segment with this start and offset, meters."""
    along = jnp.dot(point - begin, offset) / jnp.maximum(jnp.dot(offset, offset), 1e-12)
    return jnp.linalg.norm(point - begin - jnp.clip(along, 0, 1) * offset)
