"""Robots that drive about a known house, and what their cameras have shown by when: partial maps to train on.

They drive shortest ways to random places and to objects, one after the other, so that their maps are those of robots
that know where to go, and of such that do not. Everything is for one robot; `jax.vmap` or `jax.lax.map` makes it many.

Headings are counter-clockwise from east, radians; rows grow southward.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax.objectnav.agent import CAMERA_HEIGHT, CAMERA_PITCH, FIELD_OF_VIEW, IMAGE_SIZE
from dc2g_jax.objectnav.mapping import MapSettings
from dc2g_jax.vehicles.vehicle import wrapped

#: How far the robot's camera sees, meters, and how far below the horizon its image ends, radians.
CAMERA_RANGE = MapSettings().reach
_LOWEST_VIEW = CAMERA_PITCH + math.atan(math.tan(math.radians(FIELD_OF_VIEW) / 2) * IMAGE_SIZE[0] / IMAGE_SIZE[1])

#: The number of the view that shows a cell first, where none does.
NEVER = 255

#: Meters that a robot drives between two views, and radians that it turns at most: four steps of 0.1 s at 0.6 m/s and
#: 1.5 rad/s.
_DRIVE_A_VIEW, _TURN_A_VIEW = 0.24, 0.6

#: It turns on the spot until its way is within so many radians of where it looks.
_AHEAD = 1.0

#: A place has been reached within this distance, meters.
_REACHED = 0.3

#: Spread of a glance to the side, radians; a robot glances in every fourth view.
_GLANCE = 0.6

_NEIGHBORS = ((0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1))


class Journey(NamedTuple):
    """One robot's way and what it has seen by when.

    Attributes:
      cells: row and column where it was at each view.
      headings: where it looked.
      first_seen: number of the view that showed a cell first, `NEVER` where none did.
    """

    cells: Int[Array, "view 2"]
    headings: Float[Array, "view"]
    first_seen: UInt8[Array, "h w"]


class _Robot(NamedTuple):
    """A robot between two views: its cell, where it looks, and how many of its places it has been to."""

    cell: Int[Array, "2"]
    heading: Float[Array, ""]
    stage: Int[Array, ""]


def visible(
    heights: Float[Array, "h w"], cell_size: float, cell: Int[Array, "2"], heading: Float[Array, ""]
) -> tuple[Int[Array, "ray sample 2"], Bool[Array, "ray sample"]]:
    """Cells that are sampled along the rays of a camera, and whether it sees them.

    A cell is seen if its top rises above all that lies before it on the ray, as seen from the camera. Rays are so close
    that none of the cells in view is missed.

    Args:
      heights: of what stands in a cell, meters.
      cell_size: meters.
      cell: the camera stands in the middle of it.
      heading: of the camera.
    """
    half = math.radians(FIELD_OF_VIEW) / 2
    bearings = heading + jnp.linspace(-half, half, math.ceil(2 * half * CAMERA_RANGE / (0.84 * cell_size)))
    distance = 0.7 * cell_size * (1 + jnp.arange(math.ceil(CAMERA_RANGE / (0.7 * cell_size))))
    along = jnp.stack([-jnp.sin(bearings), jnp.cos(bearings)], axis=-1)[:, None] * distance[:, None] / cell_size
    cells = jnp.floor(cell + 0.5 + along).astype(jnp.int32)
    inside = jnp.all((cells >= 0) & (cells < jnp.array(heights.shape)), axis=-1)
    top = heights.at[cells[..., 0], cells[..., 1]].get(mode="clip")
    slope = (top - CAMERA_HEIGHT) / distance
    before = jnp.pad(jax.lax.cummax(slope, axis=1)[:, :-1], ((0, 0), (1, 0)), constant_values=-jnp.inf)
    in_view = inside & (distance <= CAMERA_RANGE) & (slope >= -math.tan(_LOWEST_VIEW))
    return cells, in_view & (slope > before)


def explore(
    heights: Float[Array, "h w"],
    cell_size: float,
    distances: Float[Array, "place h w"],
    start: Int[Array, "2"],
    places: Int[Array, "stage"],
    key: Array,
    *,
    views: int,
) -> Journey:
    """Drive from place to place, and look.

    Args:
      heights: of what stands in a cell, meters.
      cell_size: meters.
      distances: what is left of the way to each place, meters; infinite where the robot must not be.
      start: row and column where it begins; it looks anywhere.
      places: where it goes, one after the other; a place that no way leads to is passed over.
      key: where chance comes from.
      views: how many, less than `NEVER`.
    """
    first_key, views_key = jax.random.split(key)
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
    """The robot at the next view: it has turned toward its way, and driven so many cells if it looks along it."""

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
