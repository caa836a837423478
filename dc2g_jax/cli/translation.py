"""What the commands about the image-to-image translator share: its training pairs and its training."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import tyro

from dc2g_jax.cli.outputs import command_written, commit, number_or_null
from dc2g_jax.datasets.houses import HouseDataset
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainingCheckpoints, newest_step, save_network
from dc2g_jax.estimation.estimators import TranslatorCostToGo
from dc2g_jax.estimation.pix2pix import TranslatorArchitecture
from dc2g_jax.rollouts.devices import first_copy
from dc2g_jax.training.cost_to_go import check_numbers
from dc2g_jax.training.image_data import MaskKind, image_set
from dc2g_jax.training.image_evaluation import metrics_over_pairs
from dc2g_jax.training.image_pairs import ImageSet, draw_image_pairs
from dc2g_jax.training.loop import Log, Losses, Pauses, Task, train
from dc2g_jax.training.translator import TranslatorConfig, TranslatorState, init_translator, translator_step

#: A step takes seconds on a CPU.
_STEPS_PER_LOOK = 10


@dataclasses.dataclass(frozen=True)
class TranslationOptions:
    """How a translator is trained; the defaults are the paper's where it gives them.

    Attributes:
      masks: what is observed: `paper` draws strokes, blobs and strips in place of the paper's, which
        were not published, `rollout` takes what robots under way had seen.
      train_masks: observation masks of each training house.
      validation_masks: observation masks of each validation house.
      whole_share: share of training pairs in which all of the map is observed. The paper does not say how many are;
        a network that is never shown a whole map draws one as badly as if it had learned nothing.
      augment: maps are shifted, enlarged and mirrored at random, as pix2pix does; not with `--no-augment`.
      steps: optimizer steps in all.
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
    whole_share: float = 0.0625
    augment: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = True
    steps: int = 20_000
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
        check_numbers(self.learning_rate, steps=self.steps)
        _ = self.pauses  # refused here as well
        if not 0 <= self.whole_share <= 1:
            raise InputError(f"--whole-share {self.whole_share:g}: give a share from 0 to 1")
        architecture = TranslatorArchitecture(self.size, self.base_filters, self.compute_dtype)
        return TranslatorConfig(architecture, loss, self.batch_size, self.learning_rate)

    @property
    def pauses(self) -> Pauses:
        """When training pauses."""
        return Pauses(self.validate_every, self.minutes_per_checkpoint)

    def facts(self, dataset: HouseDataset, seed: int) -> dict[str, Any]:
        """What must be the same for a run to be resumed, beside the configuration."""
        names = ("masks", "train_masks", "whole_share", "augment")
        return {"seed": seed, "dataset": dataset.name, **{name: getattr(self, name) for name in names}}


class TranslationData(NamedTuple):
    """Pairs to learn from and pairs to validate on."""

    train: ImageSet
    validation: ImageSet


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
        "data": f"{dataset.name}, training split, {options.train_masks} masks a house ({options.masks}), "
        f"{100 * options.whole_share:g} % of pairs whole" + ", shifted, enlarged and mirrored" * options.augment,
        "target": "8-connected cost-to-go as a picture, brightest visible pixel 1",
        "loss": config.loss,
        "command": command_written(),
        "commit": commit(),
        "seed": seed,
        "steps": step,
    }


def require_steps(steps: int, out: Path) -> None:
    """Refuse to go on with a run of more steps than are asked for."""
    taken = newest_step(out)
    if taken > steps:
        raise InputError(f"{out}: has {taken} steps behind it; give at least as many --steps, or another --out")


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

    Leaves `network/` and `log.jsonl` in the folder, with a line for every validation. As the learning rate stays what
    it is, a run that is at its end can go on to more steps.

    Raises:
      InputError: the folder holds a run of other options or of more steps, or the loss is no number.
    """
    require_steps(options.steps, out)
    first_state = partial(init_translator, seed=seed)
    draw = partial(
        draw_image_pairs,
        batch_size=config.batch_size,
        whole_share=options.whole_share,
        augment=options.augment,
    )

    def validate(state: TranslatorState, step: int, loss: Losses | None) -> list[dict[str, Any]]:
        network = TranslatorCostToGo(weights=first_copy(state.generator), architecture=config.architecture)
        save_network(out / "network", network, _card(dataset, config, options, seed, step))
        if not options.validate_every:
            return []
        metrics = metrics_over_pairs(network, data.validation)
        known = {name: number_or_null(value) for name, value in metrics.items()}
        return [{"step": step, "train_l1": None if loss is None else float(loss), **known}]

    task = Task(
        steps=options.steps,
        init=partial(first_state, config),
        step=lambda state: translator_step(state, data.train, config=config, draw_batch=draw),
        validate=validate,
        validated=Log(out).by_step(),
        name=out.name,
        steps_per_look=_STEPS_PER_LOOK,
    )
    checkpoints = TrainingCheckpoints(out, config, options.facts(dataset, seed), first_state=first_state)
    train(task, out, checkpoints, options.pauses)
