"""Small trainings: a configuration, and data to draw from."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Int

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.runtime.devices import mesh_of, replicate
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax._src.training.step import Supervised, TrainingState, supervised_step
from dc2g_jax.indoor.learning.networks import CostMapArchitecture
from experiments.objectnav.data import JourneySet
from experiments.objectnav.training import BETTER_RECIPE, CostMapConfig
from experiments.translator.drawn_masks import drawn_masks
from experiments.translator.network import TranslatorArchitecture
from experiments.translator.pairs import ImageSet, all_pairs, draw_image_pairs
from experiments.translator.training import TranslatorConfig, TranslatorTraining
from tests.support import maps

COST_TO_GO = TrainingConfig(
    architecture=Architecture(widths=(8,) * len(Architecture().widths)),
    steps=60,
    batch_size=8,
    learning_rate=3e-3,
    average_decay=0.9,
)
DRAW_PAIRS = DataConfig(own_share=1.0, edge_weight=2.0, half_weight_cost=np.inf, jitter=0.1, whole_share=0.1).draw_batch

TRANSLATOR = TranslatorConfig(
    architecture=TranslatorArchitecture(size=32, base_filters=4), batch_size=2, learning_rate=2e-3
)
DRAW_IMAGES = functools.partial(draw_image_pairs, batch_size=TRANSLATOR.batch_size, whole_share=0.1, augment=True)

COST_MAPS = CostMapConfig(
    architecture=CostMapArchitecture(patch=20, widths=(8, 8), embedding=4, features=2, feature_width=4),
    recipe=dataclasses.replace(BETTER_RECIPE, peak=1e-2),
    steps=24,
    batch_size=4,
)


def training_set() -> TrainingSet:
    """Three small maps, each with two masks."""
    shape = (16, 16)
    terrains = np.stack([maps.random_terrain(seed, shape, 0.85, doors=2) for seed in range(3)])
    seen = np.stack([maps.random_cells(seed, shape, 0.8) for seed in range(6)])
    return TrainingSet(
        terrain=jnp.asarray(terrains),
        cost_to_go=jnp.stack([world_cost_to_go(World.from_terrain(terrain)) for terrain in terrains]),
        masks=jax.vmap(bitboard.pack)(jnp.asarray(seen)),
        mask_world=jnp.arange(6, dtype=jnp.int32) % 3,
        n_own=jnp.int32(6),
    )


def image_set() -> ImageSet:
    """The pairs of two small houses and four masks."""
    houses = [House(f"h{seed}", "train", maps.random_terrain(seed, (40, 32), 0.85)) for seed in range(2)]
    return all_pairs(houses, drawn_masks(4, 32, seed=0))


def journeys() -> JourneySet:
    """Two empty rooms with a goal of one kind in the corner, and robots that have seen half of it."""
    rows, columns = np.indices((40, 40))
    free = (rows > 0) & (columns > 0) & (rows < 39) & (columns < 39)
    meters = np.where(free, np.hypot(rows, columns) * 100, 65535).astype(np.uint16)
    none = np.full_like(meters, 65535)
    return JourneySet(
        cells=jnp.asarray(np.stack([np.where(free, 2, 3)] * 2).astype(np.uint32) << 16),
        distance=jnp.asarray(np.stack([[meters] + [none] * 4, [none] * 4 + [meters]])),
        house=jnp.asarray([0, 1], jnp.int32),
        first_seen=jnp.asarray(np.stack([np.where(rows < 20, 0, 255)] * 2).astype(np.uint8)),
        places=jnp.asarray(np.full((2, 3, 2), 20), jnp.int16),
        headings=jnp.zeros((2, 3), jnp.float32),
        features=jnp.zeros((2, 3, 2, 2), jnp.float16),
    )


class Case(NamedTuple):
    """A training: what it is of, and how much of its first loss is left after `steps`."""

    training: Supervised
    config: Any
    data: Callable[[], Any]
    hyperparameters: Any
    others: Any
    steps: int
    left: float


CASES = {
    "cost_to_go": Case(
        CostToGoTraining(COST_TO_GO.recipe, DRAW_PAIRS), COST_TO_GO, training_set, COST_TO_GO.hyperparameters,
        COST_TO_GO.hyperparameters.replace(seed=jnp.uint32(5), learning_rate=jnp.float32(1e-4)), COST_TO_GO.steps, 0.6,
    ),
    "translator": Case(
        TranslatorTraining(TRANSLATOR, DRAW_IMAGES), TRANSLATOR, image_set, jnp.uint32(0), jnp.uint32(1), 30, 0.8,
    ),
    "cost_maps": Case(
        COST_MAPS, COST_MAPS, journeys, None, None, COST_MAPS.steps, 0.8,
    ),
}  # fmt: skip


def first_state(config: TrainingConfig) -> TrainingState:
    """The state of a cost-to-go training before the first step."""
    return CostToGoTraining(config.recipe, DRAW_PAIRS).first_state(config.hyperparameters)


def train(case: Case, steps: int, state=None, devices=None, hyperparameters=None):
    """Train on from a state (the first by default); the state is used up."""
    mesh, losses = mesh_of(devices), []
    first = case.training.first_state(case.hyperparameters) if state is None else state
    state, data = replicate((first, case.data()), mesh)
    numbers = case.hyperparameters if hyperparameters is None else hyperparameters
    for _ in range(steps):
        state, loss = supervised_step(state, data, numbers, training=case.training, mesh=mesh)
        assert all(leaf.is_ready() for leaf in jax.tree.leaves((state, loss)))
        losses.append(float(loss))
    return state, losses


@struct.dataclass
class Count:
    """The state of a training that only counts its steps."""

    step: Int[Array, ""]

    @property
    def trained(self) -> Array:
        """The number of steps stands for weights."""
        return self.step

    optimizer = ()


class Counting(Supervised):
    """What trains it, at a rate that grows with the steps."""

    batch_size = 1

    def learning_rate(self, hyperparameters):
        """A tenth of the number of the step."""
        return lambda step: jnp.float32(0.1 * (step + 1))


@functools.partial(jax.jit, donate_argnames=("state",))
def count_step(state):
    """A step that uses its state up, as those of training do."""
    return Count(state.step + 1), state.step * 1.0
