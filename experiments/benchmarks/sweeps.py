"""How speed depends on the batch and on the size of the map."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence

import jax

from dc2g_jax._src.runtime.devices import cores

from .bench import SENSING_RANGE, Bench, own
from .kernels import network_row
from .planners import PLANNER_UNIT, own_episodes, plain_programs
from .programs import compile_program
from .rows import Row, growing
from .stepping import ENVIRONMENT_UNIT, own_steps, peers
from .workload import cycles, resized

#: Planner steps of every robot in one call of the batch sweep.
_CYCLES = 4

#: Robots that one call moves at the least, a batch after another.
_FEWEST_ROBOTS = 64

#: Actions after which an episode ends where the size of the map varies, so that large maps take no hours.
_STEP_LIMIT = 100


def _planner_steps(bench: Bench, planner: str, row: Row, batch: int) -> Row:
    """A few planner steps of robots in the middle of their episodes, in one program."""
    # Small batches follow one another, so that no single robot stands for all.
    robots = bench.robots(planner)
    batches = [robots.batch(batch, number) for number in range(max(1, _FEWEST_ROBOTS // batch))]
    program, memory = compile_program(cycles(bench.planner(planner), bench.rules().sensing, _CYCLES), batches[0])
    batches = [program(each) for each in batches]  # no planner's first steps, where it may do more
    measured = bench.measure(lambda: [program(each) for each in batches])
    units = float(_CYCLES * batch * len(batches))
    return row.with_figures(measured, units, facts={"program, MiB": memory / 2**20})


def planner_batches(bench: Bench, planners: Sequence[str], batches: Sequence[int]) -> Iterator[Row]:
    """Planner steps of larger and larger batches of robots in the middle of their episodes."""
    case = {"cells": bench.workload.cells, "sensing_range": SENSING_RANGE}
    for planner in planners:
        row = own("batch", f"{planner}, in the middle of episodes", PLANNER_UNIT, **case)
        yield from growing(batches, row, functools.partial(_planner_steps, bench, planner))


def batch_rows(bench: Bench) -> Iterator[Row]:
    """Batches from one to very many: robots, environments, maps."""
    batches = (4,) if bench.quick else tuple(4**power for power in range(9))
    workload = bench.workload
    case = {"cells": workload.cells, "sensing_range": SENSING_RANGE}
    yield from planner_batches(bench, ("frontier",) if bench.quick else ("oracle", "frontier", "dc2g"), batches)
    if not bench.quick:
        row = own("batch", "frontier, whole episodes by slots", PLANNER_UNIT, **case)
        sizes = [size for size in batches if size <= 256]  # slots on each core or accelerator
        yield from growing(
            sizes, row, lambda row, batch: own_episodes(bench, row, workload, "frontier", slots=batch)[0]
        )
    row = own("batch", "environment, random actions", ENVIRONMENT_UNIT, **case)
    yield from growing(batches, row, lambda row, batch: own_steps(bench, row, batch))
    row = own("batch", "network", "maps", cells=workload.cells)
    yield from growing(batches, row, lambda row, batch: network_row(bench, "batch", batch))
    yield from peers(bench, "batch", batches[:1] if bench.quick else batches[::2])


def grid_rows(bench: Bench) -> Iterator[Row]:
    """Frontier exploration of larger and larger maps: this package on all cores, C and Numba on one."""
    own_cores = cores() if jax.devices()[0].platform == "cpu" else None
    sides = {60: 4} if bench.quick else {25: 128, 50: 128, 100: 64, 200: 32, 400: 16}
    for cells, count in sides.items():
        workload = resized(bench.workload, cells, count=count)
        row = own("grid", "frontier", PLANNER_UNIT, cells=cells, sensing_range=SENSING_RANGE, cores=own_cores)
        mine, actions = own_episodes(bench, row, workload, "frontier", step_limit=_STEP_LIMIT)
        yield mine
        problem = workload.problem(sensing_range=SENSING_RANGE, step_limit=_STEP_LIMIT)
        yield from plain_programs(bench, row, problem, "frontier", actions)
        lazy = dataclasses.replace(row, what="frontier_lazy")
        yield from plain_programs(bench, lazy, problem, "frontier_lazy", actions)
