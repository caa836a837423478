"""Train the cost-to-go network: `python -m experiments.train --out checkpoints/mine`.

Interrupted or killed, it goes on where it was when run again with the same options.
"""

import dataclasses
import functools
import json
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from tqdm import tqdm

from dc2g_jax.datasets.houses import House, HouseDataset, open_dataset, stack_worlds
from dc2g_jax.datasets.pairs import TrainingSet, draw_pairs
from dc2g_jax.datasets.procedural import extra_training_houses
from dc2g_jax.datasets.starts import Start, sample_starts, why_no_episode
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainingCheckpoints, save_network
from dc2g_jax.estimation.estimators import NetworkCostToGo, world_cost_to_go
from dc2g_jax.estimation.training import TrainingConfig, init_state, train_step
from dc2g_jax.evaluation import Runner, episodes_from, summarize
from dc2g_jax.grid.sampling import sample_grid
from dc2g_jax.mask_collection import LEADERS, Masks, collect_masks, concatenate_masks, leading_planners
from dc2g_jax.planning.rules import SETTINGS, complete_rules
from experiments.common import command_line

_STEPS_PER_REPORT = 50


@dataclasses.dataclass(frozen=True)
class Options:
    """Train the cost-to-go network on pairs of partial maps and exact cost-to-go (Algorithm 1), training houses only.

    Attributes:
      out: folder for checkpoints, the network and the log; run again with the same options to resume.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      extra_houses: procedural houses to train on beside the dataset's training houses.
      starts_per_house: episodes in each of the dataset's training houses, for every sensing range and leading planner.
      starts_per_extra_house: the same for the procedural houses.
      masks_per_episode: moments of each episode that become observation masks.
      ranges: sensing ranges, in cells, of the robots whose masks are learned from.
      own_share: share of a batch drawn from the dataset's own houses rather than procedural ones, 0 to 1.
      edge_weight: weight in the loss of cells within 2 cells of unobserved ground; others have weight 1.
      steps: optimiser steps.
      batch_size: pairs a step.
      learning_rate: peak learning rate.
      seed: of everything random.
      validate_every: steps between validations; the last step is one too. 0 for none.
      minutes_per_checkpoint: how often to save, in minutes.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    dataset: str | None = None
    extra_houses: int = 400
    starts_per_house: int = 6
    starts_per_extra_house: int = 1
    masks_per_episode: int = 8
    ranges: tuple[int, ...] = (4, 5, 6, 8, 10, 12)
    own_share: float = 0.4
    edge_weight: float = 4.0
    steps: int = TrainingConfig.steps
    batch_size: int = TrainingConfig.batch_size
    learning_rate: float = TrainingConfig.learning_rate
    seed: int = 0
    validate_every: int = 2000
    minutes_per_checkpoint: float = 2.0


def drawn_houses(prefix: str, split: str, count: int, seed: int, cells: int) -> list[House]:
    """Procedural houses on the grid of the dataset's own."""
    images = extra_training_houses(count, seed)
    return [House(f"{prefix}{index:05d}", split, sample_grid(image, cells)) for index, image in enumerate(images)]


def usable(dataset: HouseDataset, split: str) -> list[House]:
    """Houses of a split in which an episode can be run.

    Raises:
      InputError: if there is none.
    """
    houses = [house for house in dataset.split(split) if why_no_episode(house) is None]
    if not houses:
        raise InputError(f"{dataset.name}: no episode can be run in any {split} house; training needs one at least")
    return houses


def observation_masks(options: Options, houses: list[House], n_own: int) -> Masks:
    """Masks of robots of all ranges under way in all houses, ordered by house."""
    index = {house.name: number for number, house in enumerate(houses)}
    worlds = stack_worlds(houses)
    height, width = houses[0].terrain.shape
    collected = []
    with tqdm(total=len(options.ranges) * LEADERS, desc="masks", unit="rollout", file=sys.stderr) as bar:
        for place, sensing_range in enumerate(options.ranges):
            rules = complete_rules(sensing_range)
            for turn, planner in enumerate(leading_planners(rules, height, width, seed=options.seed)):
                seed = (options.seed * len(options.ranges) + place) * LEADERS + turn
                starts = sample_starts(houses[:n_own], options.starts_per_house, seed=seed)
                starts += sample_starts(houses[n_own:], options.starts_per_extra_house, seed=seed)
                collected.append(
                    collect_masks(
                        planner,
                        worlds,
                        episodes_from(starts, index),
                        sensing=rules.sensing,
                        per_episode=options.masks_per_episode,
                        seed=seed,
                    )
                )
                bar.update()
    masks = concatenate_masks(collected)
    order = np.argsort(masks.world, kind="stable")
    return Masks(boards=masks.boards[order], world=masks.world[order])


def training_set(houses: list[House], n_own: int, masks: Masks) -> TrainingSet:
    """Labels of all houses (Algorithm 1, line 5) beside their masks."""
    worlds = stack_worlds(houses)
    return TrainingSet(
        terrain=jnp.moveaxis(worlds.terrain, -1, 0),
        cost_to_go=jnp.moveaxis(jax.jit(world_cost_to_go)(worlds), -1, 0),
        masks=jnp.asarray(masks.boards),
        mask_world=jnp.asarray(masks.world, jnp.int32),
        n_own=jnp.int32(np.sum(masks.world < n_own)),
    )


@dataclasses.dataclass(frozen=True)
class Validation:
    """Episodes in validation houses: the dataset's own, and procedural ones that no training has seen."""

    dataset: HouseDataset
    starts: dict[str, list[Start]]

    def figures(self, network: NetworkCostToGo) -> dict[str, float]:
        """Mean and median extra steps of `dc2g` in percent, with 5-cell and 8-cell sensing."""
        figures = {}
        for settings in ("published", "paper"):
            runner = Runner(self.dataset, SETTINGS[settings])
            for houses, starts in self.starts.items():
                results = runner.run(starts, ["dc2g"], network)
                summary = summarize([result.extra for result in results], [result.success for result in results])
                figures[f"{settings}_{houses}_mean_extra"] = round(summary.mean_extra, 2)
                figures[f"{settings}_{houses}_median_extra"] = round(summary.median_extra, 2)
        return figures


def make_validation(dataset: HouseDataset, cells: int) -> Validation:
    """Validation houses and starts, the same for every run."""
    own = usable(dataset, "val")
    drawn = drawn_houses("v", "val", 24, 10_000, cells)
    return Validation(
        dataset=HouseDataset(name="validation", source="folder", houses=(*own, *drawn)),
        starts={"own": sample_starts(own, 20, seed=0), "procedural": sample_starts(drawn, 4, seed=0)},
    )


def cached_masks(options: Options, houses: list[House], n_own: int) -> Masks:
    """Masks from the run's folder, collected and kept there the first time."""
    path = options.out / "masks.npz"
    if path.exists():
        with np.load(path) as file:
            return Masks(boards=file["boards"], world=file["world"])
    masks = observation_masks(options, houses, n_own)
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, boards=masks.boards, world=masks.world)
    partial.rename(path)
    return masks


def model_card(options: Options, dataset: HouseDataset, step: int, figures: dict[str, float]) -> dict[str, Any]:
    """What to know about a network: where it comes from and how good it is on validation houses."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return {
        "data": f"{dataset.name}, training split, and {options.extra_houses} procedural houses (seed {options.seed})",
        "masks": f"rollouts of exploring robots with sensing ranges {', '.join(map(str, options.ranges))} cells",
        "target": "4-connected cost-to-go in cells",
        "command": shlex.join(["python", "-m", "experiments.train", *sys.argv[1:]]),
        "commit": commit.stdout.strip() or "unknown",
        "seed": options.seed,
        "steps": step,
        "validation": figures,
    }


def train(options: Options, dataset: HouseDataset, config: TrainingConfig, checkpoints: TrainingCheckpoints) -> None:
    """Train to the end, saving now and then, and at Ctrl-C."""
    own = usable(dataset, "train")
    cells = own[0].terrain.shape[0]
    houses = own + drawn_houses("e", "train", options.extra_houses, options.seed, cells)
    masks = cached_masks(options, houses, len(own))
    data = training_set(houses, len(own), masks)
    print(
        f"Training on {len(own)} houses of {dataset.name} and {options.extra_houses} procedural ones: "
        f"{len(masks.world)} observation masks, {int(data.n_own)} of the dataset's own houses"
    )
    draw = functools.partial(
        draw_pairs,
        batch_size=config.batch_size,
        own_share=options.own_share if options.extra_houses else 1.0,
        edge_weight=options.edge_weight,
    )
    validation = make_validation(dataset, cells)
    state = checkpoints.restore() or init_state(config)
    step, saved = int(state.step), time.monotonic()
    with tqdm(total=config.steps, initial=step, desc="train", unit="step", file=sys.stderr) as bar:
        try:
            while step < config.steps:
                losses = []
                for _ in range(min(_STEPS_PER_REPORT - step % _STEPS_PER_REPORT, config.steps - step)):
                    state, loss = train_step(state, data, config=config, draw_batch=draw)
                    losses.append(loss)
                mean = float(np.mean(losses))
                step += len(losses)
                bar.update(len(losses))
                bar.set_postfix(loss=f"{mean:.2f}")
                if not np.isfinite(mean):
                    raise InputError(f"{options.out}: the loss is {mean} at step {step}; lower --learning-rate")
                if step == config.steps or (options.validate_every and step % options.validate_every == 0):
                    network = NetworkCostToGo(weights=state.average, architecture=config.architecture)
                    figures = validation.figures(network) if options.validate_every else {}
                    report(options, dataset, network, step, mean, figures)
                if time.monotonic() - saved > 60 * options.minutes_per_checkpoint:
                    checkpoints.save(state)
                    saved = time.monotonic()
        except KeyboardInterrupt:
            checkpoints.save(state)
            raise
    checkpoints.save(state)


def report(
    options: Options, dataset: HouseDataset, network: NetworkCostToGo, step: int, loss: float, figures: dict[str, float]
) -> None:
    """Save the network as it is, and add a line to the log."""
    save_network(options.out / "network", network, model_card(options, dataset, step, figures))
    line = json.dumps({"step": step, "loss": round(loss, 4), **figures})
    with (options.out / "log.jsonl").open("a") as log:
        log.write(line + "\n")
    tqdm.write(line, file=sys.stderr)


def main(options: Options) -> None:
    """Train, save and validate."""
    dataset = open_dataset(options.dataset)
    config = TrainingConfig(
        steps=options.steps,
        batch_size=options.batch_size,
        learning_rate=options.learning_rate,
        seed=options.seed,
    )
    apart = {"out", "dataset", "validate_every", "minutes_per_checkpoint"}
    facts = {name: value for name, value in dataclasses.asdict(options).items() if name not in apart}
    checkpoints = TrainingCheckpoints(options.out, config, {**facts, "dataset": dataset.name})
    try:
        train(options, dataset, config, checkpoints)
    finally:
        checkpoints.close()
    print(f"Trained: {options.out / 'network'}")


if __name__ == "__main__":
    command_line(Options, main)
