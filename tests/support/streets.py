"""Streets to drive on, and episodes of a vehicle that knows its map, among people, on the shortest path."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from dc2g_jax._src.grid.poses import FORWARD
from dc2g_jax._src.grid.search import FOUR_CONNECTED, cost_to_go
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE
from dc2g_jax.robot.driving.footprint import Ground, cell_at, cell_centers
from dc2g_jax.robot.driving.vehicle import VehicleLimits, VehicleState, at_rest, drive
from experiments.driving.avoidance import People, navigate
from experiments.driving.following import Path, path_through
from experiments.driving.pedestrians import PERSON_RADIUS, Pedestrians, walk, walkable_cells
from tests.support import maps

STREET = maps.drawn("""
    ..........
    RRRRRRRRRR
    RRRRRRRRRR
    ..P.......
    ..P....##.
    ..PPPPD##.
    .......##.
    ..........
""")
WALLED = np.where(STREET == FRONT_DOOR, maps.drawn("#")[0, 0], STREET)
WALLED[7, 9] = FRONT_DOOR

CELL_SIZE = 1.0
LIMITS = VehicleLimits()

#: Cells of a path.
AHEAD = 8


class Episode(NamedTuple):
    """What happened, the start first: vehicle, people, and whether the vehicle has been on a front door, which ends it.

    Axes are episodes, moments, and for people one more.
    """

    state: VehicleState
    people: Array
    arrived: Array


def plan(cost: Array, cell: Array) -> Path:
    """The next cells on the shortest path to the goal."""

    def step(cell: Array, _: None) -> tuple[Array, Array]:
        beside = jnp.concatenate([cell[None], cell + jnp.array(FORWARD)])
        inside = jnp.all((beside >= 0) & (beside < jnp.array(cost.shape)[::-1]), axis=-1)
        costs = jnp.where(inside, cost.at[beside[:, 1], beside[:, 0]].get(mode="clip"), jnp.inf)
        return beside[jnp.argmin(costs)], cell

    return path_through(jax.lax.scan(step, cell, length=AHEAD)[1], AHEAD, 0, CELL_SIZE)


@functools.partial(jax.jit, static_argnames="periods")
@functools.partial(jax.vmap, in_axes=(0, 0, 0, 0, 0, None))
def episodes(key: Array, terrain: Array, cell: Array, yaw: Array, everybody: Pedestrians, periods: int) -> Episode:
    """One episode a key: from the middle of a cell to the nearest front door, among these people."""
    drivable = jnp.asarray(TRAVERSABLE)[terrain]
    ground, sidewalks = Ground(drivable, CELL_SIZE), Ground(walkable_cells(terrain), CELL_SIZE)
    cost = cost_to_go(drivable, terrain == FRONT_DOOR, moves=FOUR_CONNECTED)

    def period(carry, key):
        state, everybody, arrived = carry
        path = plan(cost, cell_at(state.position, CELL_SIZE))
        people = People(everybody.position, everybody.velocity, PERSON_RADIUS)
        driven = drive(state, navigate(state, path, ground, people, LIMITS), LIMITS)
        walked = walk(key, everybody, sidewalks, state, LIMITS.radius)
        state, everybody = jax.tree.map(
            lambda before, after: jnp.where(arrived, before, after), (state, everybody), (driven, walked)
        )
        column, row = cell_at(state.position, CELL_SIZE)
        arrived |= terrain[row, column] == FRONT_DOOR
        return (state, everybody, arrived), Episode(state, everybody.position, arrived)

    first = at_rest(cell_centers(cell, CELL_SIZE), yaw)
    begin = first, everybody, jnp.bool_(False)
    later = jax.lax.scan(period, begin, jax.random.split(key, periods))[1]
    start = Episode(first, everybody.position, begin[2])
    return jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), start, later)
