"""Training: runs of a sweep together, and the same runs one after another."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax.datasets.pairs import TrainingSet
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.grid import bitboard
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.devices import mesh_of, replicate
from dc2g_jax.training.cost_to_go import TrainingConfig, first_state, train_step
from dc2g_jax.training.cost_to_go_data import DataConfig
from dc2g_jax.training.sweeps import (
    init_states,
    stacked_hyperparameters,
)

from .bench import Bench, own
from .rows import Row

#: Optimizer steps of a run, for the runs an hour: those of `python -m experiments.sweep_losses`.
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


def training_rows(bench: Bench) -> Iterator[Row]:
    """Runs an hour of a sweep over losses, seeds and learning rates, every way, with the same batches."""
    data, n_runs = replicate(_data(bench), mesh_of()), 2 if bench.quick else 6
    batch = 4 if bench.quick else TrainingConfig.batch_size
    configs = [
        TrainingConfig(batch_size=batch, seed=number, losses=(("quantile", 1.0), ("l1", float(number % 2))))
        for number in range(n_runs)
    ]
    recipe, hyperparameters = configs[0].recipe, stacked_hyperparameters(configs)
    draw = DataConfig(extra_houses=0).draw_batch
    # Each call goes on where the last one stopped: states are used up.
    stack = init_states(recipe, hyperparameters)
    alone = [first_state(config) for config in configs]

    def together() -> jax.Array:
        nonlocal stack
        stack, losses = train_step(stack, hyperparameters, data, recipe=recipe, draw_batch=draw)
        return losses

    def one_after_another() -> list[jax.Array]:
        losses = []
        for number, config in enumerate(configs):
            alone[number], loss = train_step(
                alone[number], config.hyperparameters, data, recipe=recipe, draw_batch=draw
            )
            losses.append(loss)
        return losses

    ways: dict[str, Callable[[], Any]] = {"together": together, "one after another": one_after_another}
    for what, call in ways.items():
        row = own("training", f"{n_runs} runs {what}", "runs/h", batch=batch, cells=bench.workload.cells)
        measured = bench.measure(call)
        yield row.with_figures(measured, 3600 * n_runs / _STEPS_A_RUN, checksum=None)
