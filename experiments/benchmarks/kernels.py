"""Single kernels on robots in the middle of their episodes, beside the library functions one would reach for."""

import functools
import importlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.grid import bitboard, search
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import PoseSet, every_heading, unpack
from dc2g_jax._src.grid.sensing import expanding_kernel
from dc2g_jax._src.planning import frontiers, planners
from dc2g_jax._src.planning.selection import ExpectedCost
from dc2g_jax._src.runtime.devices import deal, mesh_of, on_each, replicate
from dc2g_jax._src.runtime.programs import jit
from tests.oracles import numpy_gridworld

from ..baselines.libraries import cost_to_go_skimage, distance_opencv, path_skimage, reachable_scipy
from .bench import PYTORCH, SENSING_RANGE, Bench, own
from .machine import BANDWIDTH, FLOAT_ARITHMETIC
from .programs import compile_program
from .rows import Row, attempt

KERNEL_UNIT = "maps"


def reachable_cells(belief: Belief) -> bitboard.Board:
    """Cells each robot can reach, from nothing."""
    return planners.reachable_cells(belief, jnp.zeros_like(belief.seen))


def _own_kernels(bench: Bench, batch: int) -> dict[str, tuple[Callable[..., Any], tuple[Any, ...]]]:
    """Name -> function and its arguments."""
    robots = bench.robots("frontier").batch(batch)
    belief, world = robots.belief, robots.world
    width = belief.width
    sensing, expanding = bench.rules().sensing, expanding_kernel(SENSING_RANGE)
    reachable = jit(reachable_cells)(belief)
    subgoals: PoseSet = jit(functools.partial(frontiers.reference, expanding=expanding))(belief, reachable)
    cells = bitboard.unpack(world.traversable, width), bitboard.unpack(world.goals, width)
    return {
        "field of view": (lambda pose: sensing.visible(pose, belief.seen, width), (belief.pose,)),
        "reachability": (reachable_cells, (belief,)),
        "frontier-expanding, reference": (
            functools.partial(frontiers.reference, expanding=expanding),
            (belief, reachable),
        ),
        "frontier-expanding, complete": (functools.partial(frontiers.complete, sensing=sensing), (belief, reachable)),
        "first action": (search.first_action, (belief.pose, subgoals, reachable)),
        "all distances": (lambda pose, reachable: search.distances(pose, reachable, width), (belief.pose, reachable)),
        "cost-to-go, 8-connected": (search.cost_to_go, cells),
        "first action to the goal": (search.first_action, (belief.pose, every_heading(world.goals), world.traversable)),
    }


def _peer(
    bench: Bench, row: Row, function: Callable[..., Any], maps: Sequence[Sequence[Any]], expected: Sequence[Any] | None
) -> Row:
    """A function of one map, on one map after another; `expected` are its answers where they should be ours."""
    given = list(zip(*maps, strict=True))
    measured = bench.measure(lambda: [function(*arguments) for arguments in given])
    facts = {}
    if expected is not None:
        facts["same answer"] = float(np.allclose(np.asarray(measured.output), expected, rtol=1e-5, atol=1e-5))
    return row.with_figures(measured, float(len(given)), facts=facts)


def _peers(bench: Bench, count: int) -> Iterator[Row]:
    """Libraries and the plain NumPy program, on the maps of the first few robots."""
    world, belief, _ = bench.robots("frontier").batch(count)
    reached = jit(reachable_cells)(belief)
    expanding = frontiers.reference(belief, reached, expanding=expanding_kernel(SENSING_RANGE))

    def first(values: Any) -> np.ndarray:
        """The same with the maps along the first axis."""
        return np.ascontiguousarray(np.moveaxis(np.asarray(values), -1, 0))

    boards = (belief.seen, belief.traversable, reached, world.traversable, world.goals)
    cells = [bitboard.unpack(board, belief.width) for board in boards]
    seen, free, reachable, ground, goals = map(first, cells)
    costs, subgoals = first(search.cost_to_go(*cells[3:])), first(unpack(expanding, belief.width))
    actions = search.first_action(belief.pose, expanding, reached).action
    x, y, heading = (np.asarray(part).tolist() for part in (belief.pose.x, belief.pose.y, belief.pose.heading))
    poses = list(zip(x, y, heading, strict=True))
    plain_expanding = functools.partial(numpy_gridworld.frontier_expanding_reference, radius=SENSING_RANGE)

    def plain_action(*arguments: Any) -> int:
        return (numpy_gridworld.shortest_actions(*arguments) or [0])[0]

    cases: list[tuple[str, str, Callable[..., Any], tuple[Any, ...], Any]] = [
        ("reachability", "scipy.ndimage.label", reachable_scipy, (free, x, y), reachable),
        ("reachability", "NumPy", numpy_gridworld.reachable, (free, x, y), reachable),
        ("frontier-expanding, reference", "NumPy", plain_expanding, (seen, reachable, poses), subgoals),
        ("first action", "NumPy", plain_action, (reachable, poses, subgoals), actions),
        ("cost-to-go, 8-connected", "skimage.graph.MCP_Geometric", cost_to_go_skimage, (ground, goals), costs),
        (
            "first action to the goal",
            "skimage.graph.MCP (cells, turns not counted)",
            path_skimage,
            (ground, x, y, goals),
            None,
        ),
        ("cost-to-go, 8-connected", "cv2.distanceTransform (ignores obstacles)", distance_opencv, (goals,), None),
    ]
    for what, by, function, maps, expected in cases:
        row = Row("kernels", what, by=by, unit=KERNEL_UNIT, batch=1, cells=bench.workload.cells, cores=1)
        yield attempt(row, functools.partial(_peer, bench, row, function, maps, expected))


def kernel_rows(bench: Bench) -> Iterator[Row]:
    """Each kernel alone, with its share of the machine's bandwidth and arithmetic."""
    batch = 32 if bench.quick else 1024
    case = {"batch": batch, "cells": bench.workload.cells, "sensing_range": SENSING_RANGE}
    for what, (function, arguments) in _own_kernels(bench, batch).items():
        compiled = jit(function)
        measured = bench.measure(functools.partial(compiled, *arguments))
        shares = bench.shares(measured.median, function, *arguments)
        yield own("kernels", what, KERNEL_UNIT, **case).with_figures(measured, float(batch), shares=shares)
    yield from _peers(bench, 4 if bench.quick else 64)


def network_row(bench: Bench, section: str, batch: int) -> Row:
    """The network alone on partial maps."""
    belief = bench.robots("frontier").batch(batch).belief
    weights, terrain = bench.network.weights, jnp.moveaxis(belief.terrain, -1, 0)
    program, _ = compile_program(functools.partial(compact_unet.apply, bench.network.architecture), weights, terrain)
    measured = bench.measure(lambda: program(weights, terrain))
    architecture, seconds = bench.network.architecture, measured.median
    operations = 2 * compact_unet.multiply_accumulates(architecture, bench.workload.cells, bench.workload.cells)
    least_bytes = sum(leaf.nbytes for leaf in jax.tree.leaves((weights, terrain))) + measured.output.nbytes
    shares = {
        BANDWIDTH: least_bytes / seconds / bench.peaks[BANDWIDTH],
        FLOAT_ARITHMETIC: batch * operations / seconds / bench.peaks[FLOAT_ARITHMETIC],
    }
    row = own(section, "network", KERNEL_UNIT, batch=batch, cells=bench.workload.cells)
    return row.with_figures(measured, float(batch), shares=shares, facts={"operations/map": operations})


@functools.cache
def network_pace_row(bench: Bench) -> Row:
    """The network alone, asked by every core at once as rollouts of `dc2g` do: the pace it sets for them."""
    batch, mesh = 4 if bench.quick else planners.DC2G.batch_per_core, mesh_of()
    belief = bench.robots("frontier").batch(batch).belief
    terrain = np.repeat(np.moveaxis(np.asarray(belief.terrain), -1, 0), mesh.size, axis=0)
    network = bench.network.summarized(ExpectedCost(distance_weight=0.0).summary)
    apply = functools.partial(compact_unet.apply, network.architecture)
    program = jit(lambda weights, terrain: on_each(lambda own, weights: apply(weights, own), mesh, terrain, weights))
    inputs = (replicate(network.weights, mesh), deal(terrain, len(terrain), mesh))
    measured = bench.measure(lambda: jax.block_until_ready(program(*inputs)))
    row = own("network", "network, every core at once", KERNEL_UNIT, batch=len(terrain), cells=bench.workload.cells)
    return row.with_figures(measured, float(len(terrain)))


def _network_in_torch(bench: Bench, batch: int, compiled: bool, row: Row) -> Row:
    torch_network = importlib.import_module("experiments.baselines.torch_network")
    network = bench.network
    apply = torch_network.estimator(network.architecture, jax.device_get(network.weights), compiled=compiled)
    terrain = jnp.moveaxis(bench.robots("frontier").batch(batch).belief.terrain, -1, 0)
    measured = bench.measure(functools.partial(apply, *torch_network.tensors(terrain)))
    expected = compact_unet.apply(network.architecture, network.weights, terrain)
    same = float(np.allclose(np.asarray(measured.output), expected, rtol=1e-5, atol=1e-3))
    return row.with_figures(measured, float(batch), facts={"same answer": same})


def network_rows(bench: Bench) -> Iterator[Row]:
    """Maps a second at a few batch sizes, and PyTorch's."""
    yield network_pace_row(bench)
    for batch in (4,) if bench.quick else (1, 16, 64, 128, 256):
        row = network_row(bench, "network", batch)
        yield row
        for by, compiled in PYTORCH.items():
            peer = Row("network", row.what, by, row.unit, batch=batch, cells=row.cells)
            yield attempt(peer, functools.partial(_network_in_torch, bench, batch, compiled, peer))
