"""Results of object searches, by the metrics of Table I of the paper on dense cost maps.

All metrics refer to the true house:

- A search succeeds if the robot declares success within 1 m of an object of the wanted class, but not through a wall.
  Just around the end of a wall counts. A search without declaration in time fails, wherever the robot is.
- SPL weights success by the length of the shortest path divided by that of the driven path, at most 1. The shortest
  path is that of the fast marching method for a robot with a body, to within 1 m of such an object. It is a few percent
  too long where it runs across the grid, see `maps.fast_marching`.
- DTS, the distance to success, is the length of the remaining path at the end, 0 for a success.
- Acceleration and jerk are means of absolute values over the control periods of a search, along the path and in turns.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.maps.classes import NO_OBJECT, OBJECT_CLASSES
from dc2g_jax.indoor.maps.cost_maps import REACH, straight_distance, with_tight_cells
from dc2g_jax.indoor.maps.fast_marching import geodesic_distance
from dc2g_jax.indoor.search.searches import Search, Searches
from dc2g_jax.robot import CONTROL_PERIOD, cell_at
from dc2g_jax.runtime import jit


class SearchResult(NamedTuple):
    """Results of one search.

    Attributes:
      house: name of the house.
      target: name of the wanted class.
      x: x of the start, meters.
      y: y of the start, meters.
      yaw: yaw at the start, radians.
      agent: name of the agent.
      declared: whether the robot declared success.
      success: whether the search succeeded.
      spl: success weighted by path length, 0 to 1.
      shortest: length of the shortest path, meters.
      driven: length of the driven path, meters.
      distance: distance to success at the end (DTS), meters.
      steps: control periods.
      collisions: control periods in which an obstacle stopped the robot.
      acceleration: meters per second squared.
      turn_acceleration: radians per second squared.
      jerk: meters per second cubed.
      turn_jerk: radians per second cubed.
    """

    house: str
    target: str
    x: float
    y: float
    yaw: float
    agent: str
    declared: bool
    success: bool
    spl: float
    shortest: float
    driven: float
    distance: float
    steps: int
    collisions: int
    acceleration: float
    turn_acceleration: float
    jerk: float
    turn_jerk: float


def success_region(house: IndoorHouse, target: str) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """The cells of a house where a search for a class succeeds.

    Returns:
      Distance to drive from each cell to these cells, meters, infinite where no path leads there; and whether a cell is
      one of them.
    """
    world = house.world
    free, classes, cell_size = np.asarray(world.free), np.asarray(world.classes), float(world.cell_size)
    goals, walls = classes == OBJECT_CLASSES.index(target), ~free & (classes == NO_OBJECT)
    distance, cells = _success_region(goals, walls, free, world.fits, cell_size)
    return np.asarray(distance), np.asarray(cells)


@functools.partial(jit, static_argnames=("cell_size",))
def _success_region(goals: Array, walls: Array, free: Array, fits: Array, cell_size: float) -> tuple[Array, Array]:
    """See `success_region`. Where a robot does not fit, distances lead over free floor to where it does."""
    cells = free & jnp.isfinite(straight_distance(goals, walls, cell_size, REACH))
    distance = geodesic_distance(fits, fits & cells, cell_size)
    return with_tight_cells(distance, free, fits, cell_size), cells


def results_of(
    agent: str, houses: Sequence[IndoorHouse], episodes: Sequence[Search], searches: Searches
) -> list[SearchResult]:
    """Results of the searches of an agent."""
    by_name = {house.name: house for house in houses}
    regions = {key: success_region(by_name[key[0]], key[1]) for key in {(one.house, one.target) for one in episodes}}
    results = []
    for number, episode in enumerate(episodes):
        steps, declared = int(searches.steps[number]), bool(searches.declared[number])
        track = searches.track[number, : steps + 1].astype(float)
        distance, succeeds = regions[episode.house, episode.target]
        ends = jnp.asarray(track[[0, -1], :2], jnp.float32)
        cells = np.asarray(cell_at(ends, float(by_name[episode.house].world.cell_size)))
        first, last = ((int(row), int(column)) for column, row in cells)
        shortest, driven = float(distance[first]), float(np.hypot(*np.diff(track[:, :2], axis=0).T).sum())
        success = declared and bool(succeeds[last])
        acceleration, jerk = (_mean_rate(track[:, 3:], order) for order in (1, 2))
        results.append(
            SearchResult(
                **episode._asdict(),
                agent=agent,
                declared=declared,
                success=success,
                spl=success * shortest / max(shortest, driven, 1e-9),
                shortest=shortest,
                driven=driven,
                distance=0.0 if succeeds[last] else float(distance[last]),
                steps=steps,
                collisions=int(searches.collisions[number]),
                acceleration=acceleration[0],
                turn_acceleration=acceleration[1],
                jerk=jerk[0],
                turn_jerk=jerk[1],
            )
        )
    return results


def _mean_rate(speeds: Float[np.ndarray, "time 2"], order: int) -> tuple[float, float]:
    """Mean absolute values of a derivative of speed and turn rate; 0 for tracks that are too short."""
    rates = np.abs(np.diff(speeds, n=order, axis=0)) / CONTROL_PERIOD**order
    along, turning = rates.mean(axis=0).tolist() if len(rates) else (0.0, 0.0)
    return along, turning
