"""Time the decisions of the online planner: `python -m experiments.latency`; for one core, put `taskset -c 0` first.

`planning.online.OnlinePlanner` leads robots through houses that no result is reported on. Each call of its
`plan` is timed.
"""

import dataclasses
import functools
import gc
import itertools
import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.cli.common import check_planners, command_line, network_for
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.poses import ACTION_LETTERS, make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from experiments.support.commands import PlannerOption

from .benchmarks.machine import describe
from .benchmarks.workload import Workload, make_workload, resized


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, OutOptions):
    """Time the planner's decisions, one call at a time, in whole episodes.

    Attributes:
      cells: side lengths of the maps, in cells.
      calls: decisions to time on each map size.
      repeats: number of repeats, with the same decisions.
      planner: `frontier`, `dc2g` or `dc2g_uncertain`; package.module:Name for one of your own.
      sensing_range: range of the field of view, in cells.
    """

    cells: tuple[int, ...] = (50, 100)
    calls: int = 500
    repeats: int = 3
    planner: PlannerOption = "dc2g"
    sensing_range: int = 8


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


def main(options: Options) -> None:
    """Time the decisions, print a table and write `latency.json`."""
    require_positive(options, "calls", "repeats", "sensing_range")
    if min(options.cells, default=0) < 1:
        raise InputError(f"--cells {' '.join(map(str, options.cells))}: give one side at least, each of 1 or more")
    houses = make_workload(open_dataset(options.dataset), per_house=1)
    check_planners([options.planner])
    network = network_for([options.planner], options.network)
    out = output_folder(options, "latency")
    machine = describe()
    print(f"{options.planner} on {machine['cpu']}, {machine['cores']} cores, load {machine['load']}, times in ms")
    columns = ("cells", "calls", "first", "p50", "p99", "worst")
    print("".join(f"{column:>8}" for column in columns))
    rows = []
    for cells in options.cells:
        workload = houses if cells == houses.cells else resized(houses, cells, count=16)
        planner = OnlinePlanner(
            options.planner, network=network, sensing_range=options.sensing_range, largest=(cells, cells)
        )
        # Otherwise, garbage collection would scan all of JAX's objects during some call, for a tenth of a second.
        gc.collect()
        gc.freeze()
        for _ in range(options.repeats):
            taken = list(itertools.islice(waits(planner, workload, options.sensing_range), options.calls))
            p50, p99 = np.percentile(taken, (50, 99))
            times = (round(1e3 * float(seconds), 2) for seconds in (taken[0], p50, p99, max(taken)))
            rows.append(dict(zip(columns, (cells, len(taken), *times), strict=True)))
            print("{:8d}{:8d}{:8.2f}{:8.2f}{:8.2f}{:8.2f}".format(*rows[-1].values()), flush=True)
    facts = {
        "planner": options.planner,
        "sensing_range": options.sensing_range,
        "dataset": houses.dataset,
        "machine": machine,
        "rows": rows,
    }
    write_json(out / "latency.json", facts)
    print(f"Written: {out / 'latency.json'}")


if __name__ == "__main__":
    command_line(Options, main)
