"""What the commands about the image-to-image translator share: its training pairs and its training."""

import dataclasses
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from dc2g_jax.datasets.drawn_masks import drawn_masks
from dc2g_jax.datasets.houses import House, HouseDataset, stack_worlds
from dc2g_jax.datasets.image_pairs import ImageSet, all_pairs, draw_image_pairs, houses_with_door, labelled_maps
from dc2g_jax.datasets.starts import sample_starts, why_no_episode
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainingCheckpoints, save_network
from dc2g_jax.estimation.estimators import TranslatorCostToGo
from dc2g_jax.estimation.translator import TranslatorArchitecture
from dc2g_jax.estimation.translator_training import (
    TranslatorConfig,
    TranslatorState,
    init_translator,
    translator_step,
)
from dc2g_jax.evaluation import episodes_from
from dc2g_jax.grid.sampling import sample_grid
from dc2g_jax.image_evaluation import GRID_CELLS, mean_metrics
from dc2g_jax.mask_collection import LEADERS, Masks, collect_masks, concatenate_masks, leading_planners
from dc2g_jax.planning.rules import SETTINGS
from experiments.outputs import command_written, commit
from experiments.training_loop import FiniteLoss, run_steps

MaskKind = Literal["paper", "rollout"]

#: Masks differ from split to split, and are the same in every run.
MASK_SEEDS = {"train": 0, "val": 1, "test": 2}

_MOMENTS = 8
#: A step takes seconds on a CPU.
_STEPS_PER_LOOK = 10


@dataclasses.dataclass(frozen=True)
class TranslationOptions:
    """How a translator is trained; the defaults are the paper's.

    Attributes:
      masks: what is observed: `paper` draws strokes, blobs and strips, `rollout` takes what robots under way had seen.
      train_masks: observation masks of each training house.
      validation_masks: observation masks of each validation house.
      steps: optimiser steps.
      batch_size: pairs a step.
      learning_rate: of Adam.
      size: rows and columns of the pictures; a power of two of at least 32.
      base_filters: channels of the generator's and the discriminator's first layer.
      compute_dtype: numbers that the networks compute with.
      validate_every: steps between validations; the last step is one too. 0 for none.
      minutes_per_checkpoint: how often to save, in minutes.
    """

    masks: MaskKind = "paper"
    train_masks: int = 256
    validation_masks: int = 80
    steps: int = TranslatorConfig.steps
    batch_size: int = TranslatorConfig.batch_size
    learning_rate: float = TranslatorConfig.learning_rate
    size: int = TranslatorArchitecture.size
    base_filters: int = TranslatorArchitecture.base_filters
    compute_dtype: Literal["float32", "bfloat16"] = "float32"
    validate_every: int = 500
    minutes_per_checkpoint: float = 5.0

    def config(self, loss: str) -> TranslatorConfig:
        """What the package is asked to train.

        Raises:
          InputError: for networks that cannot be built.
        """
        try:
            architecture = TranslatorArchitecture(self.size, self.base_filters, self.compute_dtype)
        except ValueError as error:
            raise InputError(f"networks: {error}") from None
        return TranslatorConfig(architecture, loss, self.steps, self.batch_size, self.learning_rate)

    def facts(self, dataset: HouseDataset, seed: int) -> dict[str, Any]:
        """What must be the same for a run to be resumed, beside the configuration."""
        return {"seed": seed, "dataset": dataset.name, "masks": self.masks, "train_masks": self.train_masks}


class TranslationData(NamedTuple):
    """Pairs to learn from and pairs to validate on."""

    train: ImageSet
    validation: ImageSet


def rollout_masks(houses: Sequence[House], per_house: int, *, seed: int) -> Masks:
    """What robots with 8-cell sensing had seen at random moments: as many masks of each house.

    Houses in which no episode can be run have none. Where a house has too few different moments, some are taken twice.

    Args:
      houses: houses on the grid that robots move on.
      per_house: masks of each house.
      seed: of starts, moments and the planners' errors.
    """
    rules = SETTINGS["paper"].rules()
    index = {house.name: number for number, house in enumerate(houses)}
    worlds = stack_worlds(houses)
    # Twice what is needed, as moments with a goal in reach do not count.
    starts = sample_starts(houses, -(-2 * per_house // (_MOMENTS * LEADERS)), seed=seed)
    planners = leading_planners(rules, *houses[0].terrain.shape, seed=seed)
    episodes = episodes_from(starts, index)
    collect = partial(collect_masks, sensing=rules.sensing, per_episode=_MOMENTS, seed=seed)
    masks = concatenate_masks([collect(planner, worlds, episodes) for planner in planners])
    rng = np.random.default_rng(seed)
    chosen = []
    for number in np.unique(masks.world):
        own = np.flatnonzero(masks.world == number)
        chosen.append(rng.choice(own, per_house, replace=len(own) < per_house))
    order = np.concatenate(chosen)
    return Masks(boards=masks.boards[order], world=masks.world[order])


def image_set(dataset: HouseDataset, split: str, *, size: int, masks: MaskKind, per_house: int) -> ImageSet:
    """Pairs of a split (Algorithm 1).

    Args:
      dataset: houses with their whole images.
      split: which of them.
      size: rows and columns of the pictures.
      masks: kind of the observation masks.
      per_house: masks of each house.

    Raises:
      InputError: if no house of the split can be used, or there are no masks.
    """
    if per_house < 1:
        raise InputError(f"{split}: {per_house} masks a house make no pairs; ask for at least 1")
    houses = houses_with_door(dataset, split)
    if masks == "paper":
        return all_pairs(houses, drawn_masks(per_house, size, seed=MASK_SEEDS[split]))
    grids = [House(house.name, split, sample_grid(house.terrain, GRID_CELLS)) for house in houses]
    if all(why_no_episode(house) for house in grids):
        raise InputError(f"{dataset.name}: no episode can be run in any {split} house; use --masks paper")
    collected = rollout_masks(grids, per_house, seed=MASK_SEEDS[split])
    terrain, cost = labelled_maps((house.terrain for house in houses), size)
    return ImageSet(
        terrain=jnp.asarray(terrain),
        cost_to_go=jnp.asarray(cost),
        masks=jnp.asarray(collected.boards),
        pair_house=jnp.asarray(collected.world, jnp.int32),
        pair_mask=jnp.arange(len(collected.world)),
    )


def translation_data(dataset: HouseDataset, options: TranslationOptions) -> TranslationData:
    """The pairs that options ask for: 7936 and 320 of the published houses unless told otherwise."""
    make = partial(image_set, dataset, size=options.size, masks=options.masks)
    return TranslationData(
        train=make("train", per_house=options.train_masks), validation=make("val", per_house=options.validation_masks)
    )


def _card(
    dataset: HouseDataset, config: TranslatorConfig, options: TranslationOptions, seed: int, step: int
) -> dict[str, Any]:
    """What to know about a network: where it comes from."""
    return {
        "data": f"{dataset.name}, training split, {options.train_masks} masks a house ({options.masks})",
        "target": "8-connected cost-to-go as a picture, brightest visible pixel 1",
        "loss": config.loss,
        "command": command_written(),
        "commit": commit(),
        "seed": seed,
        "steps": step,
    }


def train_translator(
    out: Path,
    dataset: HouseDataset,
    data: TranslationData,
    config: TranslatorConfig,
    options: TranslationOptions,
    *,
    seed: int,
) -> None:
    """Train a translator to the end, from where an earlier run in the same folder stopped; save at Ctrl-C.

    Leaves `network/` and `log.jsonl` in the folder, with a line for every validation.
    """
    first_state = partial(init_translator, seed=seed)
    checkpoints = TrainingCheckpoints(out, config, options.facts(dataset, seed), first_state=first_state)
    draw = partial(draw_image_pairs, batch_size=config.batch_size)
    difference = FiniteLoss(out)

    def validate(state: TranslatorState, step: int) -> None:
        network = TranslatorCostToGo(weights=state.generator, architecture=config.architecture)
        save_network(out / "network", network, _card(dataset, config, options, seed, step))
        if options.validate_every:
            log(out, step, difference.latest, mean_metrics(network, data.validation))

    try:
        state = checkpoints.restore() or first_state(config)
        run_steps(
            state,
            int(state.step),
            config.steps,
            take_step=lambda state: translator_step(state, data.train, config=config, draw_batch=draw),
            look=difference,
            validate=validate,
            validate_every=options.validate_every,
            save=checkpoints.save,
            minutes_per_checkpoint=options.minutes_per_checkpoint,
            description=out.name,
            steps_per_look=_STEPS_PER_LOOK,
        )
    finally:
        checkpoints.close()


def log(out: Path, step: int, train_l1: float, validation: dict[str, float]) -> None:
    """Add a validation to the log."""
    with (out / "log.jsonl").open("a") as file:
        file.write(json.dumps({"step": step, "train_l1": train_l1, **validation}) + "\n")


def read_log(out: Path) -> dict[int, dict[str, float]]:
    """Validations by step, in order. Steps taken again after an interruption count once."""
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    return {line["step"]: line for line in sorted(lines, key=lambda line: line["step"])}
