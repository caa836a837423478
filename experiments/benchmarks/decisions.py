"""Durations of the online planner's decisions, and of its network's estimates."""

import functools
import itertools
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from dc2g_jax._src.estimation.estimators import Estimator, trait
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.poses import ACTION_LETTERS, make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT
from dc2g_jax._src.runtime.programs import jit

from .timing import measure
from .workload import Workload


class LatencyRow(NamedTuple):
    """One repeat. Times are in milliseconds.

    Attributes:
      cells: side length of the map.
      calls: timed decisions, including the first.
      first: time of the first call.
      p50: median.
      p99: 99th percentile.
      worst: time of the slowest call.
    """

    cells: int
    calls: int
    first: float
    p50: float
    p99: float
    worst: float


def waits(planner: OnlinePlanner, workload: Workload, sensing_range: int) -> Iterator[float]:
    """Yield the duration of each decision in seconds, episode after episode."""
    sensing = field_of_view(sensing_range)
    reset = jit(functools.partial(gridworld.reset, sensing=sensing))
    step = jit(functools.partial(gridworld.step, sensing=sensing))
    terrain = {house.name: house.terrain for house in workload.houses}
    for start in itertools.cycle(workload.starts):
        world = World.from_terrain(terrain[start.house])
        belief = reset(world, make_pose(start.x, start.y, start.heading))
        for _ in range(STEP_LIMIT):
            grid, pose = np.asarray(belief.terrain), jax.device_get(belief.pose)
            begin = time.perf_counter()
            decision = planner.plan(grid, (pose.x, pose.y, pose.heading))
            yield time.perf_counter() - begin
            if decision.action is None:
                break
            belief = step(world, belief, jnp.int32(ACTION_LETTERS.index(decision.action)))


@jit
def _ask(estimator: Estimator, terrain: UInt8[Array, "h w"], before: Float[Array, "1 h w"]) -> Float[Array, "1 h w"]:
    """The mean estimate for a robot in the middle of a map."""
    pose, extent = make_pose(terrain.shape[1] // 2, terrain.shape[0] // 2, 0), trait(estimator, "extent")
    outcomes = estimator.estimate(extent.part(terrain, pose), ())
    return extent.merged(jnp.mean(outcomes, axis=0, keepdims=True), pose, before)


def milliseconds(estimators: Mapping[str, Estimator], house: House) -> dict[str, float]:
    """Duration of one estimate by planner name, for a single map whose middle has been observed."""
    rows, columns = house.terrain.shape
    terrain = np.zeros_like(house.terrain)
    middle = slice(rows // 4, -rows // 4), slice(columns // 4, -columns // 4)
    terrain[middle] = house.terrain[middle]
    before = jnp.zeros((1, rows, columns))
    times = {name: measure(lambda: _ask(one, terrain, before), repeats=9).median for name, one in estimators.items()}  # noqa: B023
    return {name: round(1e3 * seconds, 2) for name, seconds in times.items()}
