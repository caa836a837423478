"""Training: runs of a sweep together, and the same runs one after another; one run beside PyTorch."""

import dataclasses
import functools
import importlib
from collections.abc import Callable, Collection, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.runtime.devices import mesh_for_batch, replicate, reuse_memory, settle
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, Hyperparameters, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax._src.training.step import TrainingState, draw_batches, learn, placed, stacked, supervised_step

from .bench import PYTORCH, Bench, own
from .rows import Row, attempt

#: Optimizer steps of a run, for the runs an hour: those of `dc2g sweep`.
_STEPS_A_RUN = 2000


def _data(bench: Bench) -> TrainingSet:
    """Whole maps of a few houses under random masks; what is in them does not matter to the speed."""
    houses = bench.workload.houses[:8]
    terrain = jnp.asarray(np.stack([house.terrain for house in houses]))
    worlds = jax.tree.map(lambda leaf: leaf[..., : len(houses)], bench.workload.worlds)
    seen = np.random.default_rng(0).random((64, *terrain.shape[1:])) < 0.5
    return TrainingSet(
        terrain=terrain,
        cost_to_go=jnp.moveaxis(jit(world_cost_to_go)(worlds), -1, 0),
        masks=jax.vmap(bitboard.pack)(jnp.asarray(seen)),
        mask_world=jnp.arange(64, dtype=jnp.int32) % len(houses),
        n_own=jnp.int32(64),
    )


def training_rows(
    bench: Bench, n_runs: int | None = None, ways: Collection[str] = ("together", "one after another"), steps: int = 1
) -> Iterator[Row]:
    """Runs an hour of a sweep over losses, seeds and learning rates, every way, with the same batches.

    Args:
      bench: what to measure with.
      n_runs: how many runs; a few where `None`.
      ways: how they are trained.
      steps: optimizer steps of each run in a call. An accelerator is given the next step before one has ended.
    """
    n_runs = n_runs or (2 if bench.quick else 6)
    batch = 4 if bench.quick else TrainingConfig.batch_size
    configs = [
        TrainingConfig(batch_size=batch, seed=number, losses=(("quantile", 1.0), ("l1", float(number % 2))))
        for number in range(n_runs)
    ]
    training = CostToGoTraining(configs[0].recipe, DataConfig(extra_houses=0).draw_batch)

    def trained(
        step: Callable[..., Any], states: list[TrainingState], numbers: list[Hyperparameters]
    ) -> list[jax.Array]:
        # Each call goes on where the last one stopped: states are used up.
        for _ in range(steps):
            losses = []
            for run, of_run in enumerate(numbers):
                states[run], loss = step(states[run], hyperparameters=of_run)
                losses.append(loss)
        return losses

    reuse_memory()  # as a training does
    for way in ways:
        row = own("training", f"{n_runs} runs {way}", "runs/h", batch=batch, cells=bench.workload.cells)
        numbers = [each.hyperparameters for each in configs]
        states, mesh = [training.first_state(each) for each in numbers], mesh_for_batch(batch)
        if way == "together":
            states, numbers, mesh = [stacked(states)], [stacked(numbers)], mesh_for_batch(batch, n_runs)
        states = [placed(state, mesh) for state in states]
        step = functools.partial(supervised_step, data=replicate(_data(bench), mesh), training=training, mesh=mesh)
        measured = bench.measure(functools.partial(trained, step, states, numbers))
        facts = {"steps of a run/s": steps / measured.median}
        yield row.with_figures(measured, 3600 * n_runs * steps / _STEPS_A_RUN, checksum=None, facts=facts)


def step_rows(bench: Bench) -> Iterator[Row]:
    """A run whose batches are given, here and in PyTorch: drawing them is not counted."""
    config = TrainingConfig(batch_size=4 if bench.quick else TrainingConfig.batch_size)
    training = CostToGoTraining(config.recipe, DataConfig(extra_houses=0).draw_batch)
    mesh, numbers = mesh_for_batch(config.batch_size), config.hyperparameters
    states = [placed(training.first_state(numbers), mesh)]
    weights = jax.device_get(states[0].weights)
    batch = draw_batches(states[0], replicate(_data(bench), mesh), numbers, training=training, mesh=mesh)
    settle(batch)

    reuse_memory()

    def step() -> jax.Array:
        states[0], loss = learn(states[0], batch, numbers, training=training)
        settle(states[0])
        return loss

    def with_run(row: Row, step: Callable[[], Any]) -> Row:
        return row.with_figures(bench.measure(step), 3600 / _STEPS_A_RUN, checksum=None)

    def in_torch(row: Row, compiled: bool) -> Row:
        torch_network = importlib.import_module("experiments.baselines.torch_network")
        pairs = torch_network.tensors(batch.terrain, batch.target, batch.weight)
        return with_run(row, functools.partial(torch_network.Trainer(config, weights, compiled=compiled), *pairs))

    row = own("training", "1 run, batches given", "runs/h", batch=config.batch_size, cells=bench.workload.cells)
    yield with_run(row, step)
    for by, compiled in PYTORCH.items():
        peer = dataclasses.replace(row, by=by)
        yield attempt(peer, functools.partial(in_torch, peer, compiled))
