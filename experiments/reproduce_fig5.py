"""Train the paper's image-to-image translator; Fig. 5: three losses compared on validation pairs throughout training.

`python -m experiments.reproduce_fig5 --out outputs/fig5`. After an interruption, --resume continues it.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from dc2g_jax._src.cli.common import command_line, digests
from dc2g_jax._src.cli.options import DatasetOptions, OptionalInt, TrainingOptions
from dc2g_jax._src.cli.outputs import command_written, commit, output_folder, print_files
from dc2g_jax._src.estimation.checkpoints import newest_step, write_network
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.runtime.devices import mesh_of, platform, require_memory
from dc2g_jax._src.runtime.errors import InputError, check_number, check_seed
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.loop import Log, Pauses, Task, fit
from dc2g_jax._src.training.tracking import TrackerName, run_folder
from experiments.support.commands import number_or_null
from experiments.translator.evaluation import metrics_over_pairs
from experiments.translator.figures import plot_training
from experiments.translator.network import (
    TRANSLATOR,
    Normalization,
    TranslatorArchitecture,
    TranslatorCostToGo,
    with_statistics,
)
from experiments.translator.pairs import ImageSet, MaskKind, draw_image_pairs, image_set
from experiments.translator.training import TRANSLATOR_LOSSES, DrawImages, TranslatorConfig, TranslatorTraining

#: Steps between progress updates. A step takes seconds on a CPU.
_STEPS_PER_LOOK = 10

#: Training images whose statistics a network with batch normalization uses after training.
_IMAGES_OF_STATISTICS = 96


@dataclasses.dataclass(frozen=True)
class TranslationOptions(Pauses):
    """Training of a translator. The defaults are the paper's if it gives them.

    Attributes:
      masks: observation masks: `paper` draws strokes, blobs and strips instead of the paper's masks, which were not
        published; `rollout` takes the observed cells of exploring robots.
      train_masks: observation masks of each training house.
      validation_masks: observation masks of each validation house.
      whole_share: share of training pairs with a fully observed map. The paper does not give it; a network that was
        never trained on whole maps predicts them as badly as an untrained one.
      no_augment: train without random shifts, scaling and flips, which pix2pix has.
      steps: total number of optimizer steps.
      batch_size: pairs per step.
      learning_rate: learning rate of Adam.
      size: rows and columns of the images; a power of two of at least 32.
      base_filters: channels of the first layer of the generator and the discriminator.
      normalization: `instance`: by the statistics of each image. `batch`: by those of the batch, and after training by
        those of 96 training images.
      compute_dtype: data type for computations of the networks.
    """

    masks: MaskKind = "paper"
    train_masks: int = 256
    validation_masks: int = 80
    whole_share: float = 0.0625
    no_augment: bool = False
    steps: int = 20_000
    batch_size: int = TranslatorConfig.batch_size
    learning_rate: float = TranslatorConfig.learning_rate
    size: int = TranslatorArchitecture.size
    base_filters: int = TranslatorArchitecture.base_filters
    normalization: Normalization = "instance"
    compute_dtype: Literal["float32", "bfloat16"] = "float32"
    validate_every: OptionalInt = 500

    def config(self, loss: str) -> TranslatorConfig:
        """The training configuration.

        Raises:
          InputError: an option is invalid.
        """
        check_number("--steps", self.steps, whole=True, least=1)
        self.check_pauses()
        check_number("--whole-share", self.whole_share, least=0, most=1)
        architecture = TranslatorArchitecture(self.size, self.base_filters, self.compute_dtype, self.normalization)
        images = 2 * 3 * 4.0 * self.size**2  # of the map and of the cost, RGB
        require_memory(self.batch_size * images, f"--batch-size {self.batch_size}")
        if self.normalization == "batch":
            require_memory(_IMAGES_OF_STATISTICS * images, f"--size {self.size}")
        return TranslatorConfig(architecture, loss, self.batch_size, self.learning_rate)

    def draw(self, batch_size: int) -> DrawImages:
        """Draws the pairs of a step."""
        augment = not self.no_augment
        return partial(draw_image_pairs, batch_size=batch_size, whole_share=self.whole_share, augment=augment)


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, TrainingOptions, TranslationOptions):
    """Reproduce Fig. 5: train the image-to-image translator (Algorithm 1, section III-B) with each loss several times.

    The networks are in `runs/LOSS-seedSEED/network`. Validation metrics are plotted over training steps. A resumed run
    may be given more `--steps`.

    Attributes:
      losses: losses to compare: L1 loss, adversarial loss, and their sum weighted 100 to 1.
      seeds: seeds to train each loss with.
      window: number of validations in the moving average of each run.
    """

    losses: tuple[str, ...] = tuple(TRANSLATOR_LOSSES)
    seeds: tuple[int, ...] = (0, 1, 2)
    window: int = 5


class TranslationData(NamedTuple):
    """Training pairs and validation pairs."""

    train: ImageSet
    validation: ImageSet


def translation_data(dataset: HouseDataset, options: TranslationOptions) -> TranslationData:
    """The pairs for the options: by default 7936 and 320 of the published houses."""
    make = partial(image_set, dataset, size=options.size, masks=options.masks)
    return TranslationData(
        train=make("train", per_house=options.train_masks), validation=make("val", per_house=options.validation_masks)
    )


def train_translators(
    out: Path,
    seeds: Mapping[str, int],
    dataset: HouseDataset,
    data: TranslationData,
    config: TranslatorConfig,
    options: TranslationOptions,
    *,
    track: TrackerName | None = None,
) -> None:
    """Train one translator, or several together, continuing an earlier run. Ctrl-C saves a checkpoint.

    Runs go on when their loss is not finite. Writes `network/` to each run's folder, and `log.jsonl` to `out`, with one
    line per validation and run. The learning rate is constant, so a finished run can be continued with more steps.

    Args:
      out: folder of all runs.
      seeds: the seed of each run by its name.
      dataset: the houses.
      data: pairs made of them.
      config: training configuration of all runs.
      options: options of all runs.
      track: tracker to send the curves to.

    Raises:
      InputError: a folder holds a run with other options.
    """
    configs = {run: dataclasses.replace(config, seed=seed) for run, seed in seeds.items()}
    card = {
        "data": f"{dataset.name}, training split, {options.train_masks} masks a house ({options.masks}), "
        f"{100 * options.whole_share:g} % of pairs whole"
        + ("" if options.no_augment else ", shifted, enlarged and turned"),
        "target": "8-connected cost-to-go as a picture, brightest visible pixel 1",
        "loss": config.loss,
        "command": command_written(),
        "commit": commit(),
    }

    @cache
    def some_images() -> Array:
        return jit(options.draw(_IMAGES_OF_STATISTICS))(jax.random.key(0), jnp.int32(0), data.train).image

    def generator(weights: Any) -> Any:
        if config.architecture.normalization == "instance":
            return weights["generator"]
        return with_statistics(config.architecture, weights["generator"], some_images())

    def validate(weights: Any, step: int) -> dict[str, float | None]:
        if not options.validate_every:
            return {}
        network = TranslatorCostToGo(jax.tree.map(jnp.asarray, generator(weights)), config.architecture)
        metrics = metrics_over_pairs(network, data.validation)
        return {name: number_or_null(value) for name, value in metrics.items()}

    def save(folder: Path, weights: Any, facts: dict[str, Any]) -> None:
        seed = next(seed for run, seed in seeds.items() if run_folder(out, run) == folder)
        write_network(
            folder / "network", generator(weights), config.architecture, TRANSLATOR, {**card, "seed": seed, **facts}
        )

    options_of_data = ("masks", "train_masks", "whole_share", "no_augment")
    task = Task(
        training=TranslatorTraining(config, options.draw(config.batch_size)),
        data=data.train,
        runs=configs,
        steps=options.steps,
        validate=validate,
        save=save,
        facts={"dataset": dataset.name, **{name: getattr(options, name) for name in options_of_data}},
        name=", ".join(seeds),
        steps_per_look=_STEPS_PER_LOOK,
    )
    fit(task, out, options, track)


def main(options: Options) -> None:
    """Train all runs, the seeds of a loss together on an accelerator, then plot them."""
    if not options.losses or not options.seeds or options.window < 1 or not options.validate_every:
        raise InputError("losses, seeds, window and validate-every: Fig. 5 needs at least one of each")
    for seed in options.seeds:
        check_seed(seed, "--seeds")
    if len(set(options.seeds)) < len(options.seeds) or len(set(options.losses)) < len(options.losses):
        raise InputError("losses and seeds: give each once; a run counted twice would look like less spread")
    configs = {loss: options.config(loss) for loss in options.losses}
    dataset = open_dataset(options.dataset, cells=None)
    runs = {loss: {f"{loss}-seed{seed}": seed for seed in options.seeds} for loss in options.losses}
    for run in itertools.chain(*runs.values()):
        taken = newest_step(run_folder(options.out, run))
        if taken > options.steps:
            raise InputError(
                f"{run_folder(options.out, run)}: has {taken} steps behind it; give at least as many --steps, or "
                "another --out"
            )
    output_folder(options, "reproduce_fig5", free=("minutes_per_checkpoint", "steps"), inputs=digests(dataset))
    data = translation_data(dataset, options)
    print(
        f"Training on {len(data.train.pair_house)} pairs of {len(data.train.terrain)} houses of {dataset.name}, "
        f"validating on {len(data.validation.pair_house)}"
    )
    # Runs together are one program. Cores of a CPU are busy with one run.
    for loss, seeds in runs.items():
        for turn in [{run: seed} for run, seed in seeds.items()] if platform(mesh_of()) == "cpu" else [seeds]:
            train_translators(options.out, turn, dataset, data, configs[loss], options, track=options.track)
    logs = {loss: [Log(options.out).by_step(run) for run in seeds] for loss, seeds in runs.items()}
    caption = (
        f"{len(data.train.pair_house)} training and {len(data.validation.pair_house)} validation pairs of "
        f"{dataset.name}; {options.base_filters} filters, {options.size} x {options.size} pixels, "
        f"{options.normalization} normalization, batches of {options.batch_size}; "
        f"mean and one standard deviation of {len(options.seeds)} runs, moving average of {options.window}. "
        "Precision and recall of the pixels of all validation pairs together; a run that predicts none near a goal has "
        "no precision, and no part in the mean."
    )
    plot_training(options.out / "fig5", logs, caption, window=options.window)
    facts = {
        "dataset": dataset.name,
        "training": {field.name: getattr(options, field.name) for field in dataclasses.fields(TranslationOptions)},
        "runs": {loss: [list(log.values()) for log in own] for loss, own in logs.items()},
    }
    write_json(options.out / "results.json", facts)
    print_files(options.out)


if __name__ == "__main__":
    command_line(Options, main)
