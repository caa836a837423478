"""Many searches for objects, and what came of them: the figures of Table I of the paper on dense cost maps.

What counts is measured on the house as it is:

- An episode is a success if the robot declares to be there within 1 m of an object of the wanted class, not through a
  wall; just around the end of one counts. One that never does so within the time fails, wherever it is.
- SPL weighs it with the way: the shortest one there is by the way driven, or 1 if that is shorter. The shortest way is
  that of the fast marching method, for a robot with a body, to where such an object is within 1 m. It is a few percent
  too long where it runs across the grid, see `dc2g_jax.grid.fast_marching`, and the ratio is never more than 1.
- DTS, the distance to success, is what is left of that way at the end, 0 for a success.
- Acceleration and jerk are means over the periods of an episode, absolute values, along the way and in turning.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid.fast_marching import geodesic_distance
from dc2g_jax.objectnav.classes import NOTHING, OBJECT_CLASSES
from dc2g_jax.objectnav.cost_maps import straight_distance, with_tight_cells
from dc2g_jax.objectnav.houses import IndoorHouse
from dc2g_jax.objectnav.searches import Search, Searches
from dc2g_jax.objectnav.starts import REACH, passable
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.statistics import house_bootstrap
from dc2g_jax.vehicles.footprint import cell_at
from dc2g_jax.vehicles.vehicle import CONTROL_PERIOD


class SearchResult(NamedTuple):
    """What came of a search.

    Attributes:
      house: name of the house.
      target: name of the wanted class.
      x: of the start, meters.
      y: of the start, meters.
      yaw: where the robot faced there, radians.
      agent: name of the agent.
      declared: did it say that it was there?
      success: was it?
      spl: success weighted by path length, 0 to 1.
      shortest: the shortest way to a success, meters.
      driven: the way it drove, meters.
      distance: to success where it stopped (DTS), meters.
      steps: control periods.
      bumps: of these, those in which it ran into something.
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
    bumps: int
    acceleration: float
    turn_acceleration: float
    jerk: float
    turn_jerk: float


class WayThere(NamedTuple):
    """How far it is in a house to where an object of one class is within reach.

    Attributes:
      distance: from every cell, meters; infinite where no way leads there.
      there: cells that count as a success.
    """

    distance: Float[np.ndarray, "h w"]
    there: Bool[np.ndarray, "h w"]


def way_there(house: IndoorHouse, target: str) -> WayThere:
    """What the success of a search is measured by.

    Args:
      house: the house.
      target: name of the wanted class.
    """
    world = house.world
    free, classes, cell_size = np.asarray(world.free), np.asarray(world.classes), float(world.cell_size)
    near = _near(classes == OBJECT_CLASSES.index(target), ~free & (classes == NOTHING), cell_size)
    there = free & np.asarray(near)
    distance = np.asarray(_distance_there(free, passable(free, cell_size), there, cell_size))
    return WayThere(distance=distance, there=there)


@functools.partial(jit, static_argnames=("cell_size",))
def _near(goals: Array, closed: Array, cell_size: float) -> Bool[Array, "h w"]:
    """Cells within the success distance of an object, see `straight_distance`."""
    return jnp.isfinite(straight_distance(goals, closed, cell_size, REACH))


@functools.partial(jit, static_argnames=("cell_size",))
def _distance_there(free: Array, fits: Array, region: Array, cell_size: float) -> Float[Array, "h w"]:
    """Meters to a region; where a robot does not fit, over free floor to where it does."""
    return with_tight_cells(geodesic_distance(fits, fits & region, cell_size), free, fits, cell_size)


def results_of(
    agent: str, houses: Sequence[IndoorHouse], episodes: Sequence[Search], searches: Searches
) -> list[SearchResult]:
    """What came of each episode.

    Args:
      agent: name of the agent.
      houses: those of the episodes.
      episodes: what was searched for.
      searches: what the robots did.
    """
    by_name = {house.name: house for house in houses}
    ways = {key: way_there(by_name[key[0]], key[1]) for key in {(one.house, one.target) for one in episodes}}
    results = []
    for number, episode in enumerate(episodes):
        steps, declared = int(searches.steps[number]), bool(searches.declared[number])
        track, way = searches.track[number, : steps + 1].astype(float), ways[episode.house, episode.target]
        ends = jnp.asarray(track[[0, -1], :2], jnp.float32)
        cells = np.asarray(cell_at(ends, float(by_name[episode.house].world.cell_size)))
        first, last = ((int(row), int(column)) for column, row in cells)
        shortest, driven = float(way.distance[first]), float(np.hypot(*np.diff(track[:, :2], axis=0).T).sum())
        success = declared and bool(way.there[last])
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
                distance=0.0 if way.there[last] else float(way.distance[last]),
                steps=steps,
                bumps=int(searches.bumps[number]),
                acceleration=acceleration[0],
                turn_acceleration=acceleration[1],
                jerk=jerk[0],
                turn_jerk=jerk[1],
            )
        )
    return results


def _mean_rate(speeds: Float[np.ndarray, "time 2"], order: int) -> tuple[float, float]:
    """Mean absolute value of a derivative of speed and turn rate, 0 where there are too few."""
    rates = np.abs(np.diff(speeds, n=order, axis=0)) / CONTROL_PERIOD**order
    along, turning = rates.mean(axis=0).tolist() if len(rates) else (0.0, 0.0)
    return along, turning


class SearchSummary(NamedTuple):
    """A line of Table I: means over episodes, and intervals that hold 95 % of the means of resampled houses.

    Attributes:
      episodes: how many.
      success: share (SR).
      success_interval: its interval.
      spl: success weighted by path length.
      spl_interval: its interval.
      distance: to success (DTS), meters.
      steps: control periods (Time).
      acceleration: meters per second squared, and radians per second squared.
      jerk: meters per second cubed, and radians per second cubed.
      declared: share of episodes in which the robot declared to be there.
      bumps: periods in which it ran into something.
    """

    episodes: int
    success: float
    success_interval: tuple[float, float]
    spl: float
    spl_interval: tuple[float, float]
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]
    declared: float
    bumps: float


def summarize(results: Sequence[SearchResult], *, resamples: int = 10_000, seed: int = 0) -> SearchSummary:
    """The means of some episodes.

    Args:
      results: at least one.
      resamples: sets of houses drawn for the intervals.
      seed: of those draws.
    """
    houses = [result.house for result in results]

    def mean(name: str) -> float:
        return float(np.mean([getattr(result, name) for result in results]))

    def interval(name: str) -> tuple[float, float]:
        values = [float(getattr(result, name)) for result in results]
        return house_bootstrap(values, houses, resamples=resamples, seed=seed)

    return SearchSummary(
        episodes=len(results),
        success=mean("success"),
        success_interval=interval("success"),
        spl=mean("spl"),
        spl_interval=interval("spl"),
        distance=mean("distance"),
        steps=mean("steps"),
        acceleration=(mean("acceleration"), mean("turn_acceleration")),
        jerk=(mean("jerk"), mean("turn_jerk")),
        declared=mean("declared"),
        bumps=mean("bumps"),
    )


class Difference(NamedTuple):
    """By how much one agent is better than another in the same searches; intervals as in `SearchSummary`.

    Attributes:
      success: of the shares.
      success_interval: its interval.
      spl: of the mean success weighted by path length.
      spl_interval: its interval.
    """

    success: float
    success_interval: tuple[float, float]
    spl: float
    spl_interval: tuple[float, float]


def difference(
    better: Sequence[SearchResult], worse: Sequence[SearchResult], *, resamples: int = 10_000, seed: int = 0
) -> Difference:
    """Compare two agents search by search.

    Args:
      better: results of the one.
      worse: results of the other, in the same order.
      resamples: sets of houses drawn for the intervals.
      seed: of those draws.

    Raises:
      ValueError: the searches are not the same.
    """
    pairs = list(zip(better, worse, strict=True))
    if any(
        (one.house, one.target, one.x, one.y) != (other.house, other.target, other.x, other.y) for one, other in pairs
    ):
        raise ValueError("the two agents made different searches")
    houses = [one.house for one in better]

    def gain(name: str) -> tuple[float, tuple[float, float]]:
        gains = [float(getattr(one, name)) - float(getattr(other, name)) for one, other in pairs]
        return float(np.mean(gains)), house_bootstrap(gains, houses, resamples=resamples, seed=seed)

    return Difference(*gain("success"), *gain("spl"))
