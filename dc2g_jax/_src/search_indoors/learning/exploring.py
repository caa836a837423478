"""Partial maps for training, from simulated robots that drive through a known house.

Robots drive along shortest paths to random places and to objects, one after the other. Their maps are therefore those
of robots that know the goal and of robots that explore. All functions take one robot; use `jax.vmap` or `jax.lax.map`
for batches.

Headings are counter-clockwise from east, radians; rows grow southward.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax._src.search_indoors.maps.camera import (
    INDOOR_CAMERA_HEIGHT,
    INDOOR_CAMERA_PITCH,
    INDOOR_FIELD_OF_VIEW,
    INDOOR_IMAGE_SIZE,
)
from dc2g_jax._src.search_indoors.maps.mapping import IndoorMapSettings
from dc2g_jax._src.vehicles.vehicle import wrapped

#: Range of the robot's camera, meters, and angle of its image's lower edge below the horizon, radians.
_CAMERA_RANGE = IndoorMapSettings().reach
_LOWEST_VIEW = INDOOR_CAMERA_PITCH + math.atan(
    math.tan(math.radians(INDOOR_FIELD_OF_VIEW) / 2) * INDOOR_IMAGE_SIZE[0] / INDOOR_IMAGE_SIZE[1]
)

#: Stands for the first view of a cell that no view shows.
NEVER = 255

#: Places that a robot visits at most, one after the other.
_STAGES = 12

#: Distance driven between two views, meters, and largest turn, radians: four steps of 0.1 s at 0.6 m/s and 1.5 rad/s.
_DRIVE_A_VIEW, _TURN_A_VIEW = 0.24, 0.6

#: The robot turns in place until the direction of its path is within this angle of its heading, radians.
_AHEAD = 1.0

#: A place counts as reached within this distance, meters.
_REACHED = 0.3

#: Standard deviation of a glance to the side, radians; a robot glances in every fourth view.
_GLANCE = 0.6

_NEIGHBORS = ((0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1))


class Journey(NamedTuple):
    """The path of one robot, and when it saw each cell.

    Attributes:
      cells: row and column of the robot at each view.
      headings: heading of the camera at each view.
      first_seen: number of the view that first showed each cell, `NEVER` if none did.
    """

    cells: Int[Array, "view 2"]
    headings: Float[Array, "view"]
    first_seen: UInt8[Array, "h w"]


class _Robot(NamedTuple):
    """State of a robot between two views: its cell, its heading, and how many of its places it has reached."""

    cell: Int[Array, "2"]
    heading: Float[Array, ""]
    stage: Int[Array, ""]


def visible(
    heights: Float[Array, "h w"], cell_size: float, cell: Int[Array, "2"], heading: Float[Array, ""]
) -> tuple[Int[Array, "ray sample 2"], Bool[Array, "ray sample"]]:
    """The cells along the rays of a camera, and whether the camera sees them.

    A cell is seen if its top appears above everything in front of it on the ray. The rays are dense enough to miss no
    cell in view.

    Args:
      heights: height of each cell, meters.
      cell_size: edge of a cell, meters.
      cell: cell of the camera, which is above its center.
      heading: heading of the camera.
    """
    half = math.radians(INDOOR_FIELD_OF_VIEW) / 2
    bearings = heading + jnp.linspace(-half, half, math.ceil(2 * half * _CAMERA_RANGE / (0.84 * cell_size)))
    distance = 0.7 * cell_size * (1 + jnp.arange(math.ceil(_CAMERA_RANGE / (0.7 * cell_size))))
    along = jnp.stack([-jnp.sin(bearings), jnp.cos(bearings)], axis=-1)[:, None] * distance[:, None] / cell_size
    cells = jnp.floor(cell + 0.5 + along).astype(jnp.int32)
    inside = jnp.all((cells >= 0) & (cells < jnp.array(heights.shape)), axis=-1)
    top = heights.at[cells[..., 0], cells[..., 1]].get(mode="clip")
    slope = (top - INDOOR_CAMERA_HEIGHT) / distance
    before = jnp.pad(jax.lax.cummax(slope, axis=1)[:, :-1], ((0, 0), (1, 0)), constant_values=-jnp.inf)
    in_view = inside & (distance <= _CAMERA_RANGE) & (slope >= -math.tan(_LOWEST_VIEW))
    return cells, in_view & (slope > before)


def explore(
    heights: Float[Array, "h w"],
    cell_size: float,
    distances: Float[Array, "place h w"],
    start: Int[Array, "2"],
    key: Array,
    *,
    views: int,
) -> Journey:
    """Simulate a robot that drives from place to place in random order.

    Args:
      heights: height of each cell, meters.
      cell_size: edge of a cell, meters.
      distances: remaining distance to each place, meters; infinite where the robot must not be. Unreachable places are
        skipped.
      start: row and column of the start; the initial heading is random.
      key: random key.
      views: number of views, less than `NEVER`.
    """
    order_key, way_key = jax.random.split(key)
    places = jax.random.randint(order_key, (_STAGES,), 0, len(distances))
    first_key, views_key = jax.random.split(way_key)
    begin = _Robot(start, jax.random.uniform(first_key, minval=-math.pi, maxval=math.pi), jnp.int32(0))

    def look(carry: tuple[_Robot, Array], seed: tuple[Array, Array]) -> tuple[tuple[_Robot, Array], tuple]:
        (robot, first_seen), (number, view_key) = carry, seed
        glance_key, chance_key = jax.random.split(view_key)
        glances = jax.random.bernoulli(chance_key, 0.25)
        heading = robot.heading + jnp.where(glances, _GLANCE * jax.random.normal(glance_key), 0)
        cells, seen = visible(heights, cell_size, robot.cell, heading)
        time = jnp.where(seen, number, NEVER).astype(jnp.uint8)
        first_seen = first_seen.at[cells[..., 0], cells[..., 1]].min(time, mode="drop")
        drive = max(round(_DRIVE_A_VIEW / cell_size), 1)
        return (_driven(robot, distances, places, drive), first_seen), (robot.cell, wrapped(heading))

    never = jnp.full(heights.shape, NEVER, jnp.uint8)
    (_, first_seen), (cells, headings) = jax.lax.scan(
        look, (begin, never), (jnp.arange(views), jax.random.split(views_key, views))
    )
    return Journey(cells, headings, first_seen)


def _driven(robot: _Robot, distances: Float[Array, "place h w"], places: Int[Array, "stage"], cells: int) -> _Robot:
    """The robot at the next view: turned toward its path, and `cells` cells further if it faces along the path."""

    def left(stage: Array, at: Int[Array, "*n 2"]) -> Float[Array, "*n"]:
        place = places[stage % len(places)]
        return distances.at[place, at[..., 0], at[..., 1]].get(mode="fill", fill_value=jnp.inf)

    here = left(robot.stage, robot.cell)
    stage = robot.stage + ((here < _REACHED) | ~jnp.isfinite(here))

    def step(cell: Int[Array, "2"], _: None) -> tuple[Int[Array, "2"], None]:
        around = cell + jnp.array([(0, 0), *_NEIGHBORS])
        return around[jnp.argmin(left(stage, around))], None

    ahead, _ = jax.lax.scan(step, robot.cell, length=cells)
    down, right = ahead - robot.cell
    moves = (down != 0) | (right != 0)
    error = jnp.where(moves, wrapped(jnp.arctan2(-down, right) - robot.heading), 0)
    heading = robot.heading + jnp.clip(error, -_TURN_A_VIEW, _TURN_A_VIEW)
    drives = jnp.abs(error) < _AHEAD
    return _Robot(jnp.where(drives, ahead, robot.cell), heading, stage)
