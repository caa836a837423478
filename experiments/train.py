"""Train the cost-to-go network on the training houses: `python -m experiments.train --out checkpoints/mine`.

Interrupted with Ctrl-C or killed, it goes on where it was when run again with the same options.
"""

import dataclasses
import functools
import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from tqdm import tqdm

from dc2g_jax.datasets.houses import House, HouseDataset, open_dataset
from dc2g_jax.datasets.pairs import SYMMETRIES, TrainingSet, make_pair
from dc2g_jax.datasets.procedural import extra_training_houses
from dc2g_jax.datasets.starts import Start, sample_starts, why_no_episode
from dc2g_jax.estimation.checkpoints import TrainingCheckpoints, save_network
from dc2g_jax.estimation.estimators import ExactCostToGo, NetworkCostToGo, world_cost_to_go
from dc2g_jax.estimation.networks import Architecture
from dc2g_jax.estimation.training import TrainingConfig, init_state, mean_loss, train_step
from dc2g_jax.evaluation import Runner, episodes_from, summarize
from dc2g_jax.grid.sampling import sample_grid
from dc2g_jax.grid.sensing import field_of_view
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.mask_collection import Masks, collect_masks
from dc2g_jax.planning.planners import DC2G, Frontier, Planner
from dc2g_jax.planning.rules import SETTINGS, complete_rules
from experiments.common import command_line

#: Robots whose masks are learned from see this far, in cells; ranges in between are close enough.
RANGES = (4, 5, 6, 8, 10, 12)
#: Noise of the planners that lead them: standard deviation of the logarithm of the cost-to-go's error.
NOISE = (0.2, 0.5, 1.0)


@dataclasses.dataclass(frozen=True)
class Options:
    """Train the cost-to-go network (Algorithm 1) on training houses only.

    Attributes:
      out: folder for checkpoints, the network and the log. Run again with the same options to resume.
      dataset: folder of the dataset, or `procedural`; where not given, DC2G_DATA, the cache, or the download.
      extra_houses: procedural houses to train on beside the dataset's training houses.
      starts_per_house: episodes a training house of the dataset for every sensing range and leading planner.
      starts_per_extra_house: the same for procedural houses.
      masks_per_episode: moments of each episode that become observation masks.
      real_share: share of a batch drawn from the dataset's own houses rather than the extra ones, 0 to 1.
      steps: optimiser steps.
      batch_size: pairs a step.
      learning_rate: peak learning rate.
      seed: of everything random.
      minutes_per_checkpoint: how often to save, in minutes.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    dataset: str | None = None
    extra_houses: int = 300
    starts_per_house: int = 6
    starts_per_extra_house: int = 1
    masks_per_episode: int = 8
    real_share: float = 0.4
    steps: int = 16000
    batch_size: int = 64
    learning_rate: float = 1.5e-3
    seed: int = 0
    minutes_per_checkpoint: float = 2.0


def smooth_noise(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A smooth random field of unit standard deviation, float32 [height width]."""
    import cv2

    field = cv2.resize(rng.standard_normal((8, 8)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    return (field - field.mean()) / field.std()


def leading_planners(seed: int, sensing_range: int, height: int, width: int) -> list[Planner]:
    """The planners whose paths the masks are taken along: blind exploration, and exact cost-to-go with errors."""
    rules = complete_rules(sensing_range)
    rng = np.random.default_rng([seed, sensing_range])
    planners: list[Planner] = [Frontier(rules=rules)]
    for noise in NOISE:
        log_error = jnp.asarray(noise * smooth_noise(rng, height, width))
        planners.append(DC2G(estimator=ExactCostToGo(log_error=log_error), rules=rules))
    return planners


def observation_masks(options: Options, houses: tuple[House, ...], n_own: int) -> Masks:
    """Masks of robots of all ranges under way in all houses."""
    index = {house.name: number for number, house in enumerate(houses)}
    worlds = world_from_terrain(np.stack([house.terrain for house in houses]))
    height, width = houses[0].terrain.shape
    collected = []
    with tqdm(total=len(RANGES) * (1 + len(NOISE)), desc="masks", unit="rollout", file=sys.stderr) as bar:
        for sensing_range in RANGES:
            for turn, planner in enumerate(leading_planners(options.seed, sensing_range, height, width)):
                seed = (options.seed * len(RANGES) + RANGES.index(sensing_range)) * (1 + len(NOISE)) + turn
                starts = sample_starts(houses[:n_own], options.starts_per_house, seed=seed)
                starts += sample_starts(houses[n_own:], options.starts_per_extra_house, seed=seed)
                collected.append(
                    collect_masks(
                        planner,
                        worlds,
                        episodes_from(starts, index),
                        sensing=field_of_view(sensing_range),
                        per_episode=options.masks_per_episode,
                        seed=seed,
                    )
                )
                bar.update()
    return Masks(*(np.concatenate(parts) for parts in zip(*collected, strict=True)))


def training_houses(options: Options, dataset: HouseDataset) -> tuple[tuple[House, ...], int]:
    """Houses to train on, the dataset's own first, and how many of them are the dataset's."""
    own = [house for house in dataset.split("train") if why_no_episode(house) is None]
    cells = own[0].terrain.shape[0]
    extra = [
        House(name=f"e{index:05d}", split="train", terrain=sample_grid(image, cells))
        for index, image in enumerate(extra_training_houses(options.extra_houses, options.seed))
    ]
    return (*own, *extra), len(own)


def draw_batch(
    key: Any, data: tuple[TrainingSet, Any, Any], *, batch_size: int, real_share: float, edge_weight: float
) -> Any:
    """A random batch: masks of the dataset's own houses with probability `real_share`, in random symmetries."""
    training_set, n_own, n_masks = data
    which, place, turn = jax.random.split(key, 3)
    own = jax.random.uniform(which, (batch_size,)) < real_share
    position = jax.random.uniform(place, (batch_size,))
    low, high = jnp.where(own, 0, n_own), jnp.where(own, n_own, n_masks)
    index = jnp.minimum(low + (position * (high - low)).astype(jnp.int32), high - 1)
    symmetry = jax.random.randint(turn, (batch_size,), 0, SYMMETRIES)
    pair = jax.vmap(functools.partial(make_pair, training_set, edge_weight=edge_weight))(index, symmetry)
    return pair.terrain, pair.target, pair.weight


def make_training_set(houses: tuple[House, ...], boards: np.ndarray, owners: np.ndarray) -> TrainingSet:
    """Labels of all houses (Algorithm 1, line 5) beside their masks, masks ordered by house."""
    worlds = world_from_terrain(np.stack([house.terrain for house in houses]))
    order = np.argsort(owners, kind="stable")
    return TrainingSet(
        terrain=worlds.terrain,
        cost_to_go=jax.jit(jax.vmap(world_cost_to_go))(worlds),
        masks=jnp.asarray(boards[order]),
        mask_world=jnp.asarray(owners[order]),
    )


def validate(network: NetworkCostToGo, dataset: HouseDataset, starts: list[Start]) -> dict[str, float]:
    """Mean extra steps of `dc2g` in percent on validation houses, at 5-cell and 8-cell sensing."""
    figures = {}
    for name in ("published", "paper"):
        results = Runner(dataset, SETTINGS[name]).run(starts, ["dc2g"], network)
        n_own = sum(not start.house.startswith("v") for start in starts)
        for label, part in (("own", results[:n_own]), ("procedural", results[n_own:])):
            summary = summarize([result.extra for result in part], [result.success for result in part])
            figures[f"{name}_{label}_mean_extra"] = round(summary.mean_extra, 2)
            figures[f"{name}_{label}_median_extra"] = round(summary.median_extra, 2)
    return figures


def main(options: Options) -> None:
    """Train, save and validate."""
    dataset = open_dataset(options.dataset)
    config = TrainingConfig(
        architecture=Architecture(),
        steps=options.steps,
        batch_size=options.batch_size,
        learning_rate=options.learning_rate,
        seed=options.seed,
    )
    checkpoints = TrainingCheckpoints(options.out, config)
    houses, n_own = training_houses(options, dataset)
    kept = options.out / "masks.npz"
    if kept.exists():
        with np.load(kept) as file:
            masks = Masks(boards=file["boards"], world=file["world"])
    else:
        masks = observation_masks(options, houses, n_own)
        np.savez(kept, **masks._asdict())
    boards, owners = masks
    data = make_training_set(houses, boards, owners)
    n_masks, n_own_masks = len(owners), int(np.sum(owners < n_own))
    print(
        f"{n_own} houses of {dataset.name} and {len(houses) - n_own} procedural ones; {n_masks} masks ({n_own_masks})"
    )
    draw = functools.partial(
        draw_batch,
        batch_size=options.batch_size,
        real_share=options.real_share,
        edge_weight=config.edge_weight,
    )
    val = tuple(house for house in dataset.split("val") if why_no_episode(house) is None)
    cells = val[0].terrain.shape[0]
    val_extra = tuple(
        House(name=f"v{index:05d}", split="val", terrain=sample_grid(image, cells))
        for index, image in enumerate(extra_training_houses(24, options.seed + 10_000))
    )
    starts = sample_starts(val, 20, seed=0) + sample_starts(val_extra, 4, seed=0)
    val_set = HouseDataset(name="validation", source="folder", houses=(*val, *val_extra))
    state = checkpoints.restore() or init_state(config)
    chunk = 50
    saved = time.monotonic()
    with tqdm(total=config.steps, initial=int(state.step), desc="train", unit="step", file=sys.stderr) as bar:
        while int(state.step) < config.steps:
            count = min(chunk, config.steps - int(state.step))
            losses = []
            for _ in range(count):
                state, loss = train_step(state, (data, n_own_masks, n_masks), config=config, draw_batch=draw)
                losses.append(loss)
            bar.update(count)
            bar.set_postfix(loss=f"{float(np.mean(losses)):.2f}")
            if int(state.step) % 2000 == 0:
                network = NetworkCostToGo(weights=state.average, architecture=config.architecture)
                figures = validate(network, val_set, starts)
                print(int(state.step), json.dumps(figures), flush=True)
                save_network(options.out / "network", network, {"step": int(state.step), **figures})
            if time.monotonic() - saved > 60 * options.minutes_per_checkpoint:
                checkpoints.save(state)
                saved = time.monotonic()
    checkpoints.save(state)
    checkpoints.close()


if __name__ == "__main__":
    command_line(Options, main)
