"""Train the paper's image-to-image translator: `python -m experiments.train_translator --out checkpoints/translator`.

After an interruption, --resume continues where it stopped. It may be given more --steps.
"""

import dataclasses
from typing import Literal

from dc2g_jax._src.cli.common import command_line, digests
from dc2g_jax._src.cli.options import DatasetOptions, TrainingOptions
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.cli.translation import (
    Translation,
    TranslationOptions,
    require_steps,
    train_translators,
    translation_data,
)
from dc2g_jax._src.readers.houses import open_dataset


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, TrainingOptions):
    """Train the image-to-image translator on image pairs (Algorithm 1, section III-B), on training houses only.

    A resumed run may be given more `--steps`.

    Attributes:
      loss: L1 loss, adversarial loss, or their sum weighted 100 to 1.
      seed: seed of weights, order of the pairs and dropout.
      training: training of the translator.
    """

    loss: Literal["l1", "gan", "l1+gan"] = "l1+gan"
    seed: int = 0
    training: Translation = dataclasses.field(default_factory=TranslationOptions)


def main(options: Options) -> None:
    """Make the pairs and train on them."""
    config = options.training.config(options.loss)
    dataset = open_dataset(options.dataset, cells=None)
    if options.resume:
        require_steps(options.training.steps, options.out)
    output_folder(options, "train_translator", free=("minutes_per_checkpoint", "steps"), inputs=digests(dataset))
    data = translation_data(dataset, options.training)
    print(
        f"Training on {len(data.train.pair_house)} pairs of {len(data.train.terrain)} houses of {dataset.name}, "
        f"validating on {len(data.validation.pair_house)}"
    )
    train_translators(options.out, {"": options.seed}, dataset, data, config, options.training, track=options.track)
    print(f"Trained: {options.out / 'network'}")


if __name__ == "__main__":
    command_line(Options, main)
