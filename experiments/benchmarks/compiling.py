"""Size of each program, seconds to compile it, memory it needs."""

import dataclasses
import functools
import statistics
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp

from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.training.cost_to_go import TrainingConfig

from .bench import SENSING_RANGE, Bench, own
from .hot_programs import HotProgram, rollout_loop, training_program
from .programs import CompiledProgram, compile_program, nothing_kept
from .rows import Row


def _reset_and_step(bench: Bench, batch: int) -> dict[str, Callable[[], CompiledProgram]]:
    robots, sensing = bench.robots("frontier").batch(batch), bench.rules().sensing
    belief, world = robots.belief, robots.world
    actions = jnp.zeros(batch, jnp.int32)

    reset, step = (functools.partial(function, sensing=sensing) for function in (gridworld.reset, gridworld.step))
    return {
        "reset": lambda: compile_program(reset, world, belief.pose),
        "step": lambda: compile_program(step, world, belief, actions),
    }


def _plan(bench: Bench, planner: str, batch: int) -> Callable[[], CompiledProgram]:
    robots, chosen = bench.robots(planner).batch(batch), bench.planner(planner)
    return lambda: compile_program(
        lambda planner, belief, state: planner.plan(belief, state), chosen, robots.belief, robots.state
    )


def _rollout(bench: Bench, planner: str, slots: int) -> HotProgram:
    workload, mesh = bench.workload, mesh_of(jax.devices()[:1])
    cells, houses = workload.cells, len(workload.houses)
    return rollout_loop(bench.planner(planner), bench.rules(), slots, mesh, cells=cells, houses=houses)


def _compiled(hot: HotProgram) -> CompiledProgram:
    """Shapes are enough to compile it."""
    return compile_program(hot.program, *hot.arguments, **hot.static)


def _row(bench: Bench, what: str, batch: int, program: Callable[[], CompiledProgram]) -> Row:
    made = []
    for _ in range(1 if bench.quick else min(3, bench.repeats)):
        with nothing_kept():
            made.append(program())
    seconds = [each.trace_seconds + each.compile_seconds for each in made]
    row = own("programs", what, "s", batch=batch, cells=bench.workload.cells, sensing_range=SENSING_RANGE)
    return dataclasses.replace(
        row,
        seconds=statistics.median(seconds),
        first_seconds=seconds[0],
        repeats=len(made),
        facts={
            "equations": float(made[0].equations),
            "trace seconds": statistics.median(each.trace_seconds for each in made),
            "compile seconds": statistics.median(each.compile_seconds for each in made),
            "worst seconds": max(seconds),
            "memory, MiB": made[0].memory / 2**20,
        },
    )


def program_rows(bench: Bench) -> Iterator[Row]:
    """Reset, step, every planner's plan and rollout, and the training step."""
    batch = 16 if bench.quick else 64
    programs: dict[str, Callable[[], CompiledProgram]] = _reset_and_step(bench, batch)
    planners = ("frontier",) if bench.quick else ("oracle", "frontier", "dc2g")
    programs |= {f"plan, {planner}": _plan(bench, planner, batch) for planner in planners}
    programs |= {
        f"rollout, {planner}": functools.partial(_compiled, _rollout(bench, planner, batch)) for planner in planners
    }
    for what, program in programs.items():
        yield _row(bench, what, batch, program)
    config = TrainingConfig(batch_size=8 if bench.quick else TrainingConfig.batch_size)
    gradient = training_program("learn", 1, mesh_of(jax.devices()[:1]), config=config, cells=bench.workload.cells)
    yield _row(bench, "gradient of a training step", config.batch_size, functools.partial(_compiled, gradient))
