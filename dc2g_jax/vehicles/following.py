"""Following a planned path: regulated pure pursuit of the furthest point of the path that can be driven to straight.

The vehicle steers along the arc to that point (R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking
Algorithm", 1992), never faster than lets it stop there, and turns on the spot where the point is too far aside
("regulated": S. Macenski et al., "Regulated Pure Pursuit for Robot Path Tracking", 2023). In a corridor one cell wide
the point stays close before a corner, which slows the vehicle down; on open ground it is far ahead and smooths the
path of cells.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from dc2g_jax.grid.poses import HEADINGS
from dc2g_jax.vehicles.footprint import ROUNDING, Ground, cell_centers, free_straight, surroundings
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, wrapped


@struct.dataclass
class Path:
    """Where to drive.

    Attributes:
      points: to pass, meters; those after the last repeat it.
      yaw: how to stand in the end, counter-clockwise from +x, radians.
    """

    points: Float[Array, "n 2"]
    yaw: Float[Array, ""]


@struct.dataclass
class Following:
    """How a path is followed.

    Attributes:
      look_ahead: how far along the path the point to steer for may be, meters.
      candidates: points of the path that are tried, evenly up to there, beside the one next to the vehicle.
      largest_turn: aside of this angle the vehicle turns on the spot, radians.
      arrival: nearer than this to its end, meters, the path has been driven, and the vehicle takes on its yaw.
    """

    look_ahead: float = struct.field(pytree_node=False, default=1.5)
    candidates: int = struct.field(pytree_node=False, default=6)
    largest_turn: float = struct.field(pytree_node=False, default=1.2)
    arrival: float = struct.field(pytree_node=False, default=0.1)


def path_through(cells: Int[Array, "n 2"], length: ArrayLike, heading: ArrayLike, cell_size: float) -> Path:
    """The path through the centers of cells.

    Args:
      cells: column and row, one after the other, two at least; a cell may follow itself, where the plan turns
        on the spot.
      length: how many of them count, at least 1.
      heading: of the plan's last pose, as in `dc2g_jax.grid.poses`: 0 = +x, 1 = +row, 2 = -x, 3 = -row.
      cell_size: side of a cell, meters.
    """
    index = jnp.minimum(jnp.arange(len(cells)), jnp.asarray(length) - 1)
    # Headings count clockwise in the world, whose y grows against the rows.
    yaw = -jnp.asarray(heading, jnp.float32) * (2 * jnp.pi / HEADINGS)
    return Path(points=cell_centers(cells[index], cell_size), yaw=wrapped(yaw))


def _points_ahead(position: Float[Array, "2"], path: Path, following: Following) -> Float[Array, "points 2"]:
    """The path's point next to the vehicle, and points of the path up to `look_ahead` further."""
    begin, step = path.points[:-1], jnp.diff(path.points, axis=0)
    squared = jnp.sum(step**2, axis=-1)
    along = jnp.sum((position - begin) * step, axis=-1) / jnp.where(squared > 0, squared, 1)
    along = jnp.clip(along, 0, 1)
    nearest = jnp.argmin(jnp.sum((begin + along[:, None] * step - position) ** 2, axis=-1))
    driven = jnp.concatenate([jnp.zeros(1, jnp.float32), jnp.cumsum(jnp.sqrt(squared))])
    here = driven[nearest] + along[nearest] * (driven[nearest + 1] - driven[nearest])
    ahead = here + jnp.linspace(0, following.look_ahead, following.candidates + 1)
    return jax.vmap(jnp.interp, in_axes=(None, None, 1), out_axes=1)(ahead, driven, path.points)


def aim(
    state: VehicleState, path: Path, ground: Ground, limits: VehicleLimits, following: Following
) -> Float[Array, "2"]:
    """The furthest of the path's points ahead that the footprint can drive to straight, meters.

    If it can to none of them, the point next to the vehicle: from anywhere in a cell of the path, the way there is
    free. A vehicle that was led off its path further than that needs a new one.

    Args:
      state: of the vehicle.
      path: where to drive.
      ground: where its footprint may be.
      limits: of the vehicle.
      following: how to drive.
    """
    points = _points_ahead(state.position, path, following)
    offsets = points - state.position
    around = surroundings(ground, state.position, following.look_ahead + limits.radius)
    # Nothing is known of the surroundings further off.
    near = jnp.linalg.norm(offsets, axis=-1) < following.look_ahead + ROUNDING
    free = near & free_straight(state.position, offsets, around, limits.radius)
    return points[jnp.max(jnp.where(free, jnp.arange(len(points)), 0))]


def _stopping(distance: Float[Array, ""], deceleration: float) -> Float[Array, ""]:
    """The rate from which it takes this distance to come to rest, slowing down at every command."""
    pause = CONTROL_PERIOD / 2
    return deceleration * (jnp.sqrt(pause**2 + 2 * distance / deceleration) - pause)


def steer(
    state: VehicleState, target: Float[Array, "2"], path: Path, limits: VehicleLimits, following: Following
) -> Float[Array, "2"]:
    """The command that leads to a point: speed (meters per second) and turn rate (radians per second).

    Where the path ends, it turns the vehicle to the path's yaw.

    Args:
      state: of the vehicle.
      target: the point, meters.
      path: where the vehicle drives in the end.
      limits: of the vehicle.
      following: how to drive.
    """
    offset = target - state.position
    distance = jnp.linalg.norm(offset)
    arrived = jnp.linalg.norm(path.points[-1] - state.position) < following.arrival
    aside = wrapped(jnp.where(arrived, path.yaw, jnp.arctan2(offset[1], offset[0])) - state.yaw)
    curvature = 2 * jnp.sin(aside) / jnp.maximum(distance, following.arrival)
    speed = jnp.minimum(_stopping(distance, limits.max_acceleration), limits.max_speed)
    speed = jnp.minimum(speed, limits.max_turn_rate / jnp.maximum(jnp.abs(curvature), 1e-6))
    on_the_spot = jnp.sign(aside) * _stopping(jnp.abs(aside), limits.max_turn_acceleration)
    # Along the arc if the point is ahead, more and more on the spot the further aside it is.
    ahead = jnp.where(arrived, 0, jnp.maximum(1 - jnp.abs(aside) / following.largest_turn, 0))
    return jnp.stack([ahead * speed, ahead * speed * curvature + (1 - ahead) * on_the_spot])


def follow(
    state: VehicleState, path: Path, ground: Ground, limits: VehicleLimits, following: Following | None = None
) -> Float[Array, "2"]:
    """The command that follows a path where nobody is in the way.

    Args:
      state: of the vehicle.
      path: where to drive.
      ground: where its footprint may be.
      limits: of the vehicle.
      following: how to drive; None for the usual way.
    """
    following = Following() if following is None else following
    return steer(state, aim(state, path, ground, limits, following), path, limits, following)
