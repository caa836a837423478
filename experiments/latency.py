"""How long a robot waits for a decision: `python -m experiments.latency`; on one core, `taskset -c 0` before it.

Robots explore houses that no result is reported on, as `dc2g_jax.planning.online.OnlinePlanner` leads them; every call
of its `plan` is timed.
"""

import dataclasses
import functools
import gc
import itertools
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax.cli.common import (
    DatasetOption,
    NetworkOption,
    OutOption,
    PlannerOption,
    check_planners,
    command_line,
    network_for,
)
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.houses import open_dataset
from dc2g_jax.errors import InputError
from dc2g_jax.files.atomic import write_json
from dc2g_jax.grid import gridworld
from dc2g_jax.grid.poses import ACTION_LETTERS, make_pose
from dc2g_jax.grid.sensing import field_of_view
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.planning.online import OnlinePlanner
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.rollout import STEP_LIMIT

from .benchmarks.machine import describe
from .benchmarks.workload import Workload, make_workload, resized


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Time the planner's decisions, one call at a time, on a robot's way through whole episodes.

    Attributes:
      cells: sides of the maps, in cells.
      calls: decisions to time on each.
      repeats: how many times, the same decisions each time.
      planner: `frontier`, `dc2g` or `dc2g_uncertain`; one of your own as package.module:Class.
      sensing_range: reach of the field of view, in cells.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      network: folder of a trained network; the shipped one where not given.
      out: folder to write to; a new one below outputs/ where not given.
    """

    cells: tuple[int, ...] = (50, 100)
    calls: int = 500
    repeats: int = 3
    planner: PlannerOption = "dc2g"
    sensing_range: int = 8
    dataset: DatasetOption = None
    network: NetworkOption = None
    out: OutOption = None


class LatencyRow(NamedTuple):
    """One repeat; times in milliseconds.

    Attributes:
      cells: side of the map.
      calls: decisions timed, the first among them.
      first: the first call.
      p50: half of the calls took less.
      p99: all but one in a hundred took less.
      worst: the slowest.
    """

    cells: int
    calls: int
    first: float
    p50: float
    p99: float
    worst: float


def waits(planner: OnlinePlanner, workload: Workload, sensing_range: int) -> Iterator[float]:
    """Seconds of one decision after the other, in one episode after the other."""
    sensing = field_of_view(sensing_range)
    reset = jit(functools.partial(gridworld.reset, sensing=sensing))
    step = jit(functools.partial(gridworld.step, sensing=sensing))
    terrain = {house.name: house.terrain for house in workload.houses}
    for start in itertools.cycle(workload.starts):
        world = world_from_terrain(terrain[start.house])
        belief = reset(world, make_pose(start.x, start.y, start.heading))
        for _ in range(STEP_LIMIT):
            grid, pose = np.asarray(belief.terrain), jax.device_get(belief.pose)
            begin = time.perf_counter()
            decision = planner.plan(grid, (pose.x, pose.y, pose.heading))
            yield time.perf_counter() - begin
            if decision.action is None:
                break
            belief = step(world, belief, jnp.int32(ACTION_LETTERS.index(decision.action)))


def main(options: Options) -> None:
    """Time the decisions, print a table and write `latency.json`."""
    for name in ("calls", "repeats", "sensing_range"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name.replace('_', '-')} {getattr(options, name)}: give 1 or more")
    if min(options.cells, default=0) < 1:
        raise InputError(f"--cells {' '.join(map(str, options.cells))}: give one side at least, each of 1 or more")
    houses = make_workload(open_dataset(options.dataset), per_house=1)
    check_planners([options.planner])
    network = network_for([options.planner], options.network)
    out = output_folder(options, "latency")
    machine = describe()
    print(f"{options.planner} on {machine['cpu']}, {machine['cores']} cores, load {machine['load']}, times in ms")
    print("   cells   calls   first     p50     p99   worst")
    rows = []
    for cells in options.cells:
        workload = houses if cells == houses.cells else resized(houses, cells, count=16)
        planner = OnlinePlanner(
            options.planner, network=network, sensing_range=options.sensing_range, largest=(cells, cells)
        )
        # Else Python's collector looks through all that JAX has made, for a tenth of a second, during some call.
        gc.collect()
        gc.freeze()
        for _ in range(options.repeats):
            taken = list(itertools.islice(waits(planner, workload, options.sensing_range), options.calls))
            p50, p99 = np.percentile(taken, (50, 99))
            times = (round(1e3 * float(seconds), 2) for seconds in (taken[0], p50, p99, max(taken)))
            rows.append(LatencyRow(cells, len(taken), *times))
            print("{:8d}{:8d}{:8.2f}{:8.2f}{:8.2f}{:8.2f}".format(*rows[-1]), flush=True)
    facts = {
        "planner": options.planner,
        "sensing_range": options.sensing_range,
        "dataset": houses.dataset,
        "machine": machine,
        "rows": [row._asdict() for row in rows],
    }
    write_json(out / "latency.json", facts)
    print(f"Written: {out / 'latency.json'}")


if __name__ == "__main__":
    command_line(Options, main)
