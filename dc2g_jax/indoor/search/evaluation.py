"""Results of object searches, and the metrics of Table I of the paper on dense cost maps.

All metrics refer to the true house:

- A search succeeds if the robot declares success within 1 m of an object of the wanted class, but not through a wall.
  Just around the end of a wall counts. A search without declaration in time fails, wherever the robot is.
- SPL weights success by the length of the shortest path divided by that of the driven path, at most 1. The shortest
  path is that of the fast marching method for a robot with a body, to within 1 m of such an object. It is a few percent
  too long where it runs across the grid, see `grid.fast_marching`.
- DTS, the distance to success, is the length of the remaining path at the end, 0 for a success.
- Acceleration and jerk are means of absolute values over the control periods of a search, along the path and in turns.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dc2g_jax.files import text_table
from dc2g_jax.grid import geodesic_distance
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.learning.losses import OF_CLASSES
from dc2g_jax.indoor.maps.classes import NO_OBJECT, OBJECT_CLASSES
from dc2g_jax.indoor.maps.cost_maps import REACH, straight_distance, with_tight_cells
from dc2g_jax.indoor.search.searches import Search, Searches
from dc2g_jax.robot import CONTROL_PERIOD, cell_at
from dc2g_jax.rollouts import Mean, house_bootstrap
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


class SearchSummary(NamedTuple):
    """A line of Table I: means over episodes, of shares with 95 % bootstrap intervals over houses.

    Attributes:
      episodes: number of episodes.
      success: success rate (SR).
      spl: success weighted by path length.
      distance: distance to success (DTS), meters.
      steps: control periods (Time).
      acceleration: meters per second squared, and radians per second squared.
      jerk: meters per second cubed, and radians per second cubed.
      declared: share of episodes in which the robot declared success.
      collisions: control periods in which an obstacle stopped it.
    """

    episodes: int
    success: Mean
    spl: Mean
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]
    declared: float
    collisions: float


def summarize(results: Sequence[SearchResult], *, resamples: int = 10_000) -> SearchSummary:
    """The means and intervals of some results, one at least."""
    columns = dict(zip(SearchResult._fields, zip(*results, strict=True), strict=True))
    mean = {name: float(np.mean(values)) for name, values in columns.items() if not isinstance(values[0], str)}
    success, spl = (
        house_bootstrap(np.array(columns[name], float), columns["house"], resamples=resamples, seed=0)
        for name in ("success", "spl")
    )
    acceleration, jerk = ((mean[name], mean[f"turn_{name}"]) for name in ("acceleration", "jerk"))
    same = {name: mean[name] for name in ("distance", "steps", "declared", "collisions")}
    return SearchSummary(len(results), success, spl, acceleration=acceleration, jerk=jerk, **same)


def difference(
    better: Sequence[SearchResult], worse: Sequence[SearchResult], *, resamples: int = 10_000
) -> dict[str, Mean]:
    """Differences of `success` and `spl` between two agents in the same searches, with intervals as in `SearchSummary`.

    Raises:
      ValueError: the searches differ.
    """
    if [one[:5] for one in better] != [one[:5] for one in worse]:
        raise ValueError("the two agents made different searches")

    def gain(name: str) -> Mean:
        gains = [float(getattr(one, name)) - float(getattr(two, name)) for one, two in zip(better, worse, strict=True)]
        return house_bootstrap(gains, [one.house for one in better], resamples=resamples, seed=0)

    return {name: gain(name) for name in ("success", "spl")}


#: Titles of the agents.
AGENT_TITLES = {
    "true_cost": "true cost map",
    "random": "privileged random",
    "frontier": "frontier",
    "predicted": "predicted cost map",
    "promising": "predicted, at frontiers",
}

#: Titles of the inputs of a network, see `learning.networks.Inputs`.
ABLATION_TITLES = {"both": "both", "semantic": "only semantic map", "midlevel": "only mid-level"}

#: Metrics of the prediction in Table II, in percent.
METRICS = ("MPA", "mF1", "mIoU", "aAP5", "aAP9")


#: Table I of the paper, by the names of `SearchSummary`. `predicted` is its "Our Approach".
PAPER_TABLE1: dict[str, dict[str, Any]] = {
    name: dict(zip(("success", "spl", "distance", "steps", "acceleration", "jerk"), line, strict=True))
    for name, line in {
        "true_cost": (1.000, 0.922, 0.211, 147.459, (0.15, 2.041), (2.371, 35.006)),
        "random": (0.250, 0.208, 7.214, 402.795, (1.607, 8.920), (28.004, 156.095)),
        "predicted": (0.447, 0.329, 4.542, 327.877, (0.673, 7.318), (11.788, 128.158)),
    }.items()
}

#: Table II of the paper: `METRICS` in percent, success, SPL and distance to success in meters.
PAPER_TABLE2: dict[str, dict[str, Any]] = {
    name: dict(zip(("metrics", "success", "spl", "distance"), line, strict=True))
    for name, line in {
        "semantic": ((79.17, 76.32, 63.34, 36.49, 32.47), 0.377, 0.290, 4.803),
        "midlevel": ((79.11, 76.32, 63.47, 37.21, 33.11), 0.402, 0.287, 4.716),
        "both": ((78.76, 75.89, 62.93, 37.45, 33.39), 0.447, 0.329, 4.542),
    }.items()
}

#: Of these, the paper gives F1 and IoU of each class for its own network alone, in percent (section IV-A).
_PAPER_OF_CLASSES = (71.08, 80.68, 56.79, 69.06)


def with_interval(value: Mean, sign: str = "") -> str:
    """A mean with its interval; with a sign if `sign` is `+`."""
    middle, low, high = (f"{one:{sign}.3f}" for one in value)
    return f"{middle} ({low} to {high})"


def table1(summaries: Mapping[str, SearchSummary]) -> str:
    """Table I: a row for each agent, given by name, followed by the paper's row if it has one."""

    def row(title: str, one: Mapping[str, Any], share: Callable[[Any], str]) -> list[str]:
        pairs = ("{:.2f}, {:.2f}".format(*one[name]) for name in ("acceleration", "jerk"))
        shares = (share(one[name]) for name in ("success", "spl"))
        return [title, *shares, f"{one['distance']:.2f}", f"{one['steps']:.1f}", *pairs]

    columns = ("", "success (95 %)", "SPL (95 %)", "DTS m", "steps", "acc m/s2, rad/s2", "jerk m/s3, rad/s3")
    rows = []
    for name, one in summaries.items():
        rows.append(row(AGENT_TITLES[name], one._asdict(), with_interval))
        if name in PAPER_TABLE1:
            rows.append(row("the paper's", PAPER_TABLE1[name], "{:.3f}".format))
    return text_table(columns, rows)


def table2(metrics: Mapping[str, Mapping[str, float]], summaries: Mapping[str, SearchSummary]) -> str:
    """Table II, with the paper's row below each of ours, and then F1 and IoU of free and of occupied cells.

    Args:
      metrics: `METRICS` and `OF_CLASSES` of each network, given by the name of its inputs, in percent.
      summaries: the searches that each network led.
    """
    columns = ("", *(f"{name} %" for name in METRICS), "success", "SPL", "DTS m")
    rows, of_classes = [], []
    for name, one in summaries.items():
        ours = [metrics[name][metric] for metric in METRICS], one.success.mean, one.spl.mean, one.distance
        for title, line in ((ABLATION_TITLES[name], ours), ("the paper's", PAPER_TABLE2[name].values())):
            percent, success, spl, distance = line
            rows.append([title, *map("{:.2f}".format, percent), f"{success:.3f}", f"{spl:.3f}", f"{distance:.2f}"])
        of_classes.append([ABLATION_TITLES[name], *(f"{metrics[name][score]:.2f}" for score in OF_CLASSES)])
    of_classes.append(["the paper's (both)", *map("{:.2f}".format, _PAPER_OF_CLASSES)])
    scores = text_table(("", *(f"{score} %" for score in OF_CLASSES)), of_classes)
    return f"{text_table(columns, rows)}\n\n{scores}"
