"""Size of each program, seconds to compile it, memory it needs."""

import dataclasses
import functools
import statistics
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp

from dc2g_jax.datasets.pairs import TrainingSet
from dc2g_jax.grid import gridworld
from dc2g_jax.rollouts import rollout as rollout_module
from dc2g_jax.rollouts.devices import deal, dealt_counts, mesh_of
from dc2g_jax.rollouts.rollout import STEP_LIMIT
from dc2g_jax.training import cost_to_go
from dc2g_jax.training.cost_to_go import TrainingConfig, init_state
from dc2g_jax.training.cost_to_go_data import DataConfig

from .bench import SENSING_RANGE, Bench, own
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


def _rollout(bench: Bench, planner: str, slots: int) -> Callable[[], CompiledProgram]:
    """The loop of a rollout with so many slots."""
    workload, chosen, sensing = bench.workload, bench.planner(planner), bench.rules().sensing
    mesh, count = mesh_of(jax.devices()[:1]), len(workload.starts)
    queues, states = rollout_module._first_states(
        chosen, workload.worlds, deal(workload.episodes, count, mesh), dealt_counts(count, mesh),
        mesh=mesh, sensing=sensing, n_slots=slots, kept_steps=STEP_LIMIT,
    )  # fmt: skip

    options = {"mesh": mesh, "sensing": sensing, "step_limit": STEP_LIMIT}
    return lambda: compile_program(rollout_module._run, states, jnp.int32(1), queues, chosen, **options)


def _train_step(bench: Bench) -> Callable[[], CompiledProgram]:
    """The gradient of an optimizer step. Shapes are enough to compile it."""
    config = TrainingConfig(batch_size=_training_batch(bench))
    worlds = bench.workload.worlds
    board, map_size, n_worlds = worlds.goals.shape[:-1], (worlds.height, worlds.width), worlds.goals.shape[-1]
    data = jax.eval_shape(
        lambda: TrainingSet(
            terrain=jnp.zeros((n_worlds, *map_size), jnp.uint8),
            cost_to_go=jnp.zeros((n_worlds, *map_size)),
            masks=jnp.zeros((1024, *board), jnp.uint32),
            mask_world=jnp.zeros(1024, jnp.int32),
            n_own=jnp.int32(0),
        )
    )
    recipe, hyperparameters = config.recipe, config.hyperparameters
    state = jax.eval_shape(functools.partial(init_state, recipe), hyperparameters)
    draw = DataConfig(extra_houses=0).draw_batch

    layout, first = cost_to_go._layout(mesh_of(jax.devices()[:1]), 1), jnp.zeros(1, jnp.int32)
    parts, options = jnp.arange(recipe.parts), {"layout": layout, "recipe": recipe}
    batch = jax.eval_shape(
        functools.partial(cost_to_go._draw, draw_batch=draw, **options), state, hyperparameters, data, first, parts
    )
    return lambda: compile_program(cost_to_go._gradient, state, hyperparameters, batch, first, **options)


def _training_batch(bench: Bench) -> int:
    return 8 if bench.quick else TrainingConfig.batch_size


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
    programs |= {f"rollout, {planner}": _rollout(bench, planner, batch) for planner in planners}
    for what, program in programs.items():
        yield _row(bench, what, batch, program)
    yield _row(bench, "gradient of a training step", _training_batch(bench), _train_step(bench))
