"""A model of pedestrians on sidewalks.

A pedestrian walks from cell to cell. The next cell is drawn at random from the adjacent ones; a pedestrian turns around
only where there is no other. It keeps to one side of the cells' centers and keeps its footprint on walkable cells. It
does not step in front of a vehicle but waits. After a while it goes back and tries another path. A pedestrian who has
gone back too often, for example at a dead end, is removed. Pedestrians ignore each other.

A camera sees a pedestrian as an upright cylinder.

All functions take the pedestrians of one world; use `jax.vmap` for batches of worlds.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax.grid import CLASS_NAMES, FORWARD, UNKNOWN
from dc2g_jax.robot.driving.footprint import Ground, cell_centers, contains
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleState
from dc2g_jax.robot.mapping.camera import Frame, Intrinsics, rays
from experiments.driving.lines import distance_to_segment

#: Walking speed, meters per second; radius of the circle that a pedestrian occupies, height, and the distance that
#: pedestrians keep to a vehicle in front of them, meters.
WALKING_SPEED, PERSON_RADIUS, PERSON_HEIGHT, SPACE = 1.2, 0.25, 1.7, 0.3

#: Time for which pedestrians predict the vehicle at constant velocity, and time that they wait for it before they go
#: back, seconds; how often they go back before they are removed.
FORESIGHT, PATIENCE, RETURNS = 1.0, 2.0, 3

#: Points at most this far apart count as equal, meters.
_SAME_PLACE = 1e-3

#: Log-odds of a choice that is drawn only if there is no other.
_LAST_RESORT = -1e9

#: Coordinates of people who are not on the map, meters.
NOWHERE = 1e5


@struct.dataclass
class Pedestrians:
    """State of the pedestrians.

    Attributes:
      position: centers, meters.
      velocity: velocities, meters per second.
      came_from: column and row of the last cell whose center they passed.
      heads_for: column and row of the cell they walk to.
      side: lateral offset from the centers of cells, meters.
      waited: time they have been waiting for the vehicle, seconds.
      turned_back: how often they have gone back because of the vehicle.
    """

    position: Float[Array, "people 2"]
    velocity: Float[Array, "people 2"]
    came_from: Int[Array, "people 2"]
    heads_for: Int[Array, "people 2"]
    side: Float[Array, "people 2"]
    waited: Float[Array, "people"]
    turned_back: Int[Array, "people"]


def walkable_cells(terrain: UInt8[Array, "h w"] | UInt8[np.ndarray, "h w"]) -> Bool[Array, "h w"]:
    """The cells of a map that people walk on: sidewalks and paths."""
    return jnp.asarray(np.isin(CLASS_NAMES, ["sidewalk", "path"]))[terrain]


def place(key: Array, sidewalks: Ground, count: int, away_from: Float[Array, "2"]) -> Pedestrians:
    """Standing pedestrians at random places on sidewalks, more than three meters from the vehicle's start.

    Args:
      key: random key.
      sidewalks: walkable cells. If none is far enough from the start, pedestrians are at `NOWHERE`.
      count: number of pedestrians. If it is 0, there is one at `NOWHERE`: on several CPU devices, jax 0.11 crashes on
        arrays without elements.
      away_from: start of the vehicle, meters. The distance to the centers of cells counts.
    """
    of_cell, of_side = jax.random.split(key)
    height, width = sidewalks.cells.shape
    column, row = jnp.meshgrid(jnp.arange(width), jnp.arange(height))
    every_cell = jnp.stack([column.ravel(), row.ravel()], axis=-1)
    distance = jnp.linalg.norm(cell_centers(every_cell, sidewalks.cell_size) - away_from, axis=-1)
    free = sidewalks.cells.ravel() & (distance > 3) & (count > 0)
    count = max(count, 1)
    drawn = jax.random.categorical(of_cell, jnp.where(free, 0.0, -jnp.inf), shape=(count,))
    cells = jnp.where(jnp.any(free), every_cell[drawn], int(NOWHERE / sidewalks.cell_size))
    room = max(sidewalks.cell_size / 2 - PERSON_RADIUS - 0.01, 0)
    side = jax.random.uniform(of_side, (count, 2), minval=-room, maxval=room)
    return Pedestrians(
        position=cell_centers(cells, sidewalks.cell_size) + side,
        velocity=jnp.zeros((count, 2), jnp.float32),
        came_from=cells,
        heads_for=cells,
        side=side,
        waited=jnp.zeros(count, jnp.float32),
        turned_back=jnp.zeros(count, jnp.int32),
    )


def walk(
    key: Array, people: Pedestrians, sidewalks: Ground, vehicle: VehicleState, vehicle_radius: float
) -> Pedestrians:
    """The pedestrians one period later."""
    ahead = FORESIGHT * vehicle.speed * jnp.stack([jnp.cos(vehicle.yaw), jnp.sin(vehicle.yaw)])
    personal = PERSON_RADIUS + vehicle_radius + SPACE

    def one(key: Array, person: Pedestrians) -> Pedestrians:
        goal = cell_centers(person.heads_for, sidewalks.cell_size) + person.side
        is_there = jnp.linalg.norm(goal - person.position) < _SAME_PLACE
        came_from = jnp.where(is_there, person.heads_for, person.came_from)
        heads_for = jnp.where(is_there, _next_cell(key, person, sidewalks), person.heads_for)
        to_go = cell_centers(heads_for, sidewalks.cell_size) + person.side - person.position
        distance = jnp.linalg.norm(to_go)
        step = person.position + jnp.minimum(WALKING_SPEED * CONTROL_PERIOD / jnp.maximum(distance, 1e-6), 1) * to_go
        comes_nearer = jnp.sum((vehicle.position - person.position) * to_go) > 0
        in_the_way = comes_nearer & (distance_to_segment(step, vehicle.position, ahead) < personal)
        waited = jnp.where(in_the_way, person.waited + CONTROL_PERIOD, 0)
        gives_way = waited > PATIENCE
        turned_back = person.turned_back + gives_way
        leaves = turned_back > RETURNS
        position = jnp.where(in_the_way, person.position, step)
        return Pedestrians(
            position=jnp.where(leaves, NOWHERE, position),
            velocity=jnp.where(leaves, 0, (position - person.position) / CONTROL_PERIOD),
            came_from=jnp.where(gives_way, heads_for, came_from),
            heads_for=jnp.where(gives_way, came_from, heads_for),
            side=person.side,
            waited=jnp.where(gives_way, 0, waited),
            turned_back=turned_back,
        )

    return jax.vmap(one)(jax.random.split(key, len(people.waited)), people)


def without_people(
    frame: Frame, positions: Float[Array, "people 2"], intrinsics: Intrinsics, max_range: float
) -> tuple[Frame, Bool[Array, "people"]]:
    """A frame without the pixels that show people, and which of the people it shows.

    The camera tells people from what stands still, so its map leaves them out; they hide what is behind them.

    Args:
      frame: what the camera would see if nobody were there.
      positions: centers of the people, meters.
      intrinsics: intrinsics of the camera. It is below the people's heads and in none of them.
      max_range: range of the camera, meters.
    """
    directions = rays(intrinsics, frame.pose)
    to_person = positions - frame.pose.position[:2]
    # A ray's depth t where it enters a circle: |t d - p| = r, a quadratic equation.
    along = directions[..., 0, None] * to_person[:, 0] + directions[..., 1, None] * to_person[:, 1]
    across = directions[..., 0, None] * to_person[:, 1] - directions[..., 1, None] * to_person[:, 0]
    squared = jnp.sum(directions[..., :2] ** 2, axis=-1, keepdims=True)
    root = PERSON_RADIUS**2 * squared - across**2
    depth = (along - jnp.sqrt(jnp.maximum(root, 0))) / squared
    height = frame.pose.position[2] + depth * directions[..., 2, None]
    reach = max_range / jnp.linalg.norm(directions, axis=-1, keepdims=True)
    before = jnp.where(frame.depth > 0, frame.depth, jnp.inf)[..., None]
    is_hit = (root > 0) & (depth > 0) & (depth <= reach) & (height >= 0) & (height <= PERSON_HEIGHT)
    depth = jnp.where(is_hit & (depth < before), depth, jnp.inf)
    nearest = jnp.min(depth, axis=-1, keepdims=True)
    shown = (depth == nearest) & jnp.isfinite(nearest)
    covered = jnp.any(shown, axis=-1)
    left = dataclasses.replace(
        frame, depth=jnp.where(covered, 0, frame.depth), classes=jnp.where(covered, jnp.uint8(UNKNOWN), frame.classes)
    )
    return left, jnp.any(shown, axis=(0, 1))


def _next_cell(key: Array, person: Pedestrians, sidewalks: Ground) -> Int[Array, "2"]:
    """The next cell of a pedestrian at the center of a cell: the previous cell only if there is no other."""
    beside = person.heads_for + jnp.array(FORWARD)
    is_back = jnp.all(beside == person.came_from, axis=-1)
    free = contains(sidewalks, beside)
    drawn = jax.random.categorical(key, jnp.where(free, jnp.where(is_back, _LAST_RESORT, 0.0), -jnp.inf))
    return jnp.where(jnp.any(free), beside[drawn], person.heads_for)
