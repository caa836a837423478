"""Train the network that predicts cost maps indoors, `python -m experiments.objectnav_train`.

After an interruption, --resume continues where it stopped.
"""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import jax.numpy as jnp
import tyro

from dc2g_jax.commands import (
    CommandOptions,
    OptionalInt,
    TrainingOptions,
    check_seed,
    command_line,
    command_written,
    commit,
    output_folder,
    require_positive,
)
from dc2g_jax.datasets import PROCEDURAL
from dc2g_jax.estimation import CARD, read_network, write_network
from dc2g_jax.files import tree_sha256
from dc2g_jax.indoor.houses.dataset import IndoorHouse, indoor_houses
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, TrainedEncoder, load_encoder
from dc2g_jax.indoor.learning.networks import COST_MAPS, ENCODER_FOLDER, INPUT_CHANNELS, CostMapArchitecture, Inputs
from dc2g_jax.indoor.maps.mapping import IndoorMapSettings
from dc2g_jax.runtime import InputError, require_memory
from dc2g_jax.training import Log, Pauses, Task, fit, kept_arrays
from experiments.objectnav.collecting import CollectionConfig, collect, random_views
from experiments.objectnav.data import JourneySet
from experiments.objectnav.encoder import EncoderTraining, encoder_task
from experiments.objectnav.training import RECIPES, CostMapConfig, Recipe, figures, validation_samples

#: Training houses for the encoder and pictures of each, if no encoder is given.
_ENCODER_HOUSES, _PICTURES_A_HOUSE = 200, 40

#: Added to the seed for journeys in validation houses.
_VALIDATION_SEED = 1_000_003


@dataclasses.dataclass(frozen=True, kw_only=True)
class _CollectionOptions(CommandOptions):
    """Data of the training. Like `DataOptions` it is the last base, to stand before what is said of machines.

    Attributes:
      collection: samples to collect in the houses.
    """

    collection: tyro.conf.OmitArgPrefixes[CollectionConfig] = dataclasses.field(default_factory=CollectionConfig)


@dataclasses.dataclass(frozen=True)
class Options(TrainingOptions, Pauses, _CollectionOptions):
    """Train the network that predicts cost maps for object goals indoors (section II), on training houses only.

    Attributes:
      dataset: `procedural`, or a folder of houses in ProcTHOR's format.
      count: number of training houses; by default all of a folder, or 500 procedural ones.
      validation_houses: number of houses of the validation split.
      encoder: image encoder of another training, its folder `encoder`, which is copied to `out`; by default one is
        trained first.
      encoder_steps: optimizer steps of that encoder.
      recipe: `paper` for the paper's, `better` for the one that is better after minutes of training.
      learning_rate: peak learning rate; the recipe's by default.
      loss: the paper's equation (4), or package.module:Name for one of your own.
      inputs: inputs of the network: semantic classes, mid-level features, or both (Table II).
      patch: side length of the network's input patches, in cells.
      widths: channels of the network, from the first layer to the bottleneck.
      steps: optimizer steps.
      batch_size: samples per step.
      seed: seed of weights and batches.
      validate_every: steps between validations; the last step is validated too.
      validation_samples: number of samples to validate on.
    """

    dataset: Annotated[str, tyro.conf.arg(metavar="FOLDER")] = PROCEDURAL
    count: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    validation_houses: int = 20
    encoder: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    encoder_steps: int = 3000
    recipe: Literal["better", "paper"] = "better"
    learning_rate: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    loss: str = CostMapConfig.loss
    inputs: Inputs = CostMapArchitecture.inputs
    patch: int = CostMapArchitecture.patch
    widths: tuple[int, ...] = CostMapArchitecture.widths
    steps: int = CostMapConfig.steps
    batch_size: int = CostMapConfig.batch_size
    seed: int = 0
    validate_every: OptionalInt = 1000
    validation_samples: int = 512
    minutes_per_checkpoint: float = 2.0

    def training(self, features: int) -> CostMapConfig:
        """The training configuration for this number of mid-level features.

        Raises:
          InputError: a number is invalid.
        """
        try:
            architecture = CostMapArchitecture(
                patch=self.patch, widths=self.widths, features=features, inputs=self.inputs
            )
        except InputError as error:
            raise InputError(f"--{error}") from None
        if IndoorMapSettings.local % self.patch:
            raise InputError(
                f"--patch {self.patch}: give a divisor of {IndoorMapSettings.local}, the map's sides in cells"
            )
        recipe: Recipe = RECIPES[self.recipe]
        if self.learning_rate is not None:
            recipe = dataclasses.replace(recipe, peak=self.learning_rate)
        return CostMapConfig(architecture, recipe, self.steps, self.batch_size, self.seed, self.loss)


def _open_encoder(options: Options, houses: list[IndoorHouse]) -> TrainedEncoder:
    """The given encoder, or the one of this run, which is trained if it does not exist."""
    folder = options.out / ENCODER_FOLDER
    if options.encoder is not None and not (folder / CARD).exists():
        _, weights, architecture, card = read_network(options.encoder, ENCODER)
        write_network(folder, weights, architecture, ENCODER, card)
    if options.encoder is not None or Log(folder).by_step():  # it was given, or its training has ended
        return load_encoder(folder)
    views = random_views(
        houses[:_ENCODER_HOUSES], _PICTURES_A_HOUSE, options.collection.data_seed, options.collection.largest
    )
    training = EncoderTraining(EncoderArchitecture(), options.encoder_steps, seed=options.seed)
    task = encoder_task(training, views, {"command": command_written(), "commit": commit()})
    fit(task, folder, Pauses(0, options.minutes_per_checkpoint), options.track)
    # Load the half-precision weights that will be used.
    return load_encoder(folder)


def kept(path: Path, make: Callable[[Callable[[int], None]], JourneySet], houses: int) -> JourneySet:
    """A training set from a file, collected and saved there the first time.

    Args:
      path: the file.
      make: collects the set; takes a function to report the number of finished houses.
      houses: total number of houses.
    """
    names = [field.name for field in dataclasses.fields(JourneySet)]
    arrays = kept_arrays(path, names, lambda show: make(lambda done: show(done, houses)), unit="house")
    return JourneySet(**{name: jnp.asarray(array) for name, array in arrays.items()})


def training_task(options: Options, config: CostMapConfig, data: JourneySet, validation: JourneySet) -> Task:
    """The training task."""
    batches = validation_samples(validation, config, options.validation_samples)
    card = {
        "houses": options.dataset,
        "cell_size": IndoorMapSettings.cell_size,
        "recipe": dataclasses.asdict(config.recipe),
        "loss": config.loss,
        "command": command_written(),
        "commit": commit(),
    }
    return Task(
        training=config,
        data=data,
        runs={"": config},
        steps=config.steps,
        validate=lambda weights, step: figures(weights, batches, config),
        save=lambda folder, weights, facts: write_network(
            folder, weights, config.architecture, COST_MAPS, {**card, **facts}
        ),
        facts={name: str(getattr(options, name)) for name in ("dataset", "count", "collection")},
    )


def main(options: Options) -> None:
    """Collect samples; train, validate and save the network."""
    options.training(1)  # raises before anything is written
    require_positive(options, "count", "validation_houses", "encoder_steps", "validation_samples")
    check_seed(options.collection.data_seed, "--data-seed")
    options.check_pauses()
    if options.encoder is not None and not (options.out / ENCODER_FOLDER / CARD).exists():
        load_encoder(options.encoder)
    free = ("validate_every", "minutes_per_checkpoint", "validation_samples")
    maps = float(INPUT_CHANNELS * IndoorMapSettings.local**2)
    require_memory(options.batch_size * maps, f"--batch-size {options.batch_size}")
    count = 500 if options.count is None and options.dataset == PROCEDURAL else options.count
    print(f"Houses: {count or 'all'} of {options.dataset}", flush=True)
    read = functools.partial(indoor_houses, options.dataset, cell_size=IndoorMapSettings.cell_size)
    houses = read("train", count=count)
    largest = options.validation_houses
    unknown = read("val", count=largest if options.dataset == PROCEDURAL else None)[:largest]
    inputs = {"dataset": tree_sha256([house.world for house in (*houses, *unknown)])}
    output_folder(options, "objectnav_train", free=free, inputs=inputs)
    encoder = _open_encoder(options, houses)
    collection = options.collection
    own, others = options.out / "data.safetensors", options.out / "validation.safetensors"
    data = kept(own, functools.partial(collect, houses, encoder, collection), len(houses))
    apart = dataclasses.replace(collection, data_seed=collection.data_seed + _VALIDATION_SEED)
    validation = kept(others, functools.partial(collect, unknown, encoder, apart), len(unknown))
    print(f"Training on {data.headings.size} samples of {len(data.cells)} houses, {len(validation.cells)} to validate")
    config = options.training(encoder.architecture.features)
    fit(training_task(options, config, data, validation), options.out, options, options.track)
    print(f"Trained: {options.out}")


if __name__ == "__main__":
    command_line(Options, main)
