"""Path following: regulated pure pursuit of the farthest point of the path that is reachable in a straight line.

The vehicle steers along the arc to that point (R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking
Algorithm", 1992), slow enough to stop there. It turns in place if the direction to the point differs too much from its
yaw ("regulated": S. Macenski et al., "Regulated Pure Pursuit for Robot Path Tracking", 2023). In a corridor one cell
wide the point is close before a corner, which slows the vehicle down. On open ground the point is far ahead, which
smooths the path of cells.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from dc2g_jax.grid import HEADINGS
from dc2g_jax.robot.driving.footprint import Ground, blocked_around, cell_centers
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, wrapped
from experiments.driving.lines import ROUNDING, free_straight

#: Largest distance of the target point along the path, meters, and the number of evenly spaced points up to there that
#: are tried, besides the one nearest to the vehicle.
_LOOK_AHEAD, _CANDIDATES = 1.5, 6

#: At a larger angle to the target point, the vehicle turns in place, radians.
_LARGEST_TURN = 1.2

#: Within this distance of the path's end, meters, the vehicle only turns to the final yaw.
ARRIVAL = 0.1


@struct.dataclass
class Path:
    """A path.

    Attributes:
      points: points to pass, meters; padded with copies of the last point.
      yaw: final yaw, counter-clockwise from +x, radians.
    """

    points: Float[Array, "n 2"]
    yaw: Float[Array, ""]


def path_through(cells: Int[Array, "n 2"], length: ArrayLike, heading: ArrayLike, cell_size: float) -> Path:
    """The path through the centers of cells.

    Args:
      cells: columns and rows of consecutive cells, at least two. A cell may repeat, where the plan turns in place.
      length: number of cells that count, at least 1.
      heading: heading of the plan's last pose, as in `grid.Pose`: 0 = +x, 1 = +row, 2 = -x, 3 = -row.
      cell_size: side of a cell, meters.
    """
    index = jnp.minimum(jnp.arange(len(cells)), jnp.asarray(length) - 1)
    # Headings count clockwise in the world, whose y grows against the rows.
    yaw = -jnp.asarray(heading, jnp.float32) * (2 * jnp.pi / HEADINGS)
    return Path(points=cell_centers(cells[index], cell_size), yaw=wrapped(yaw))


def _points_ahead(position: Float[Array, "2"], path: Path) -> Float[Array, "points 2"]:
    """The point of the path nearest to the vehicle, and points of the path up to `_LOOK_AHEAD` beyond it."""
    begin, step = path.points[:-1], jnp.diff(path.points, axis=0)
    squared = jnp.sum(step**2, axis=-1)
    along = jnp.sum((position - begin) * step, axis=-1) / jnp.where(squared > 0, squared, 1)
    along = jnp.clip(along, 0, 1)
    nearest = jnp.argmin(jnp.sum((begin + along[:, None] * step - position) ** 2, axis=-1))
    driven = jnp.concatenate([jnp.zeros(1, jnp.float32), jnp.cumsum(jnp.sqrt(squared))])
    here = driven[nearest] + along[nearest] * (driven[nearest + 1] - driven[nearest])
    ahead = here + jnp.linspace(0, _LOOK_AHEAD, _CANDIDATES + 1)
    return jax.vmap(jnp.interp, in_axes=(None, None, 1), out_axes=1)(ahead, driven, path.points)


def aim(state: VehicleState, path: Path, ground: Ground, limits: VehicleLimits) -> Float[Array, "2"]:
    """The farthest point of the path ahead that the footprint can reach in a straight line, meters.

    If it can reach none, the point of the path nearest to the vehicle, which can be reached from anywhere in a cell of
    the path. A vehicle that is farther off its path needs a new path.
    """
    points = _points_ahead(state.position, path)
    offsets = points - state.position
    around = blocked_around(ground, state.position, _LOOK_AHEAD + limits.radius)
    # Blocked cells are known no farther than this.
    near = jnp.linalg.norm(offsets, axis=-1) < _LOOK_AHEAD + ROUNDING
    free = near & free_straight(state.position, offsets, around, limits.radius)
    return points[jnp.max(jnp.where(free, jnp.arange(len(points)), 0))]


def _stopping(distance: Float[Array, ""], deceleration: float) -> Float[Array, ""]:
    """The rate at which braking to rest takes this distance, with a deceleration at every command."""
    pause = CONTROL_PERIOD / 2
    return deceleration * (jnp.sqrt(pause**2 + 2 * distance / deceleration) - pause)


def steer(state: VehicleState, target: Float[Array, "2"], path: Path, limits: VehicleLimits) -> Float[Array, "2"]:
    """The command that steers to a point of a path: speed (meters per second) and turn rate (radians per second).

    At the end of the path it turns the vehicle to the path's final yaw.
    """
    offset = target - state.position
    distance = jnp.linalg.norm(offset)
    arrived = jnp.linalg.norm(path.points[-1] - state.position) < ARRIVAL
    aside = wrapped(jnp.where(arrived, path.yaw, jnp.arctan2(offset[1], offset[0])) - state.yaw)
    curvature = 2 * jnp.sin(aside) / jnp.maximum(distance, ARRIVAL)
    speed = jnp.minimum(_stopping(distance, limits.max_acceleration), limits.max_speed)
    speed = jnp.minimum(speed, limits.max_turn_rate / jnp.maximum(jnp.abs(curvature), 1e-6))
    on_the_spot = jnp.sign(aside) * _stopping(jnp.abs(aside), limits.max_turn_acceleration)
    # Along the arc if the point is ahead, more and more on the spot the further aside it is.
    ahead = jnp.where(arrived, 0, jnp.maximum(1 - jnp.abs(aside) / _LARGEST_TURN, 0))
    return jnp.stack([ahead * speed, ahead * speed * curvature + (1 - ahead) * on_the_spot])
