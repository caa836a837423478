"""Train the paper's image-to-image translator: `python -m experiments.train_translator --out checkpoints/translator`.

Interrupted or killed, it goes on where it was when run again with --resume.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dc2g_jax.cli.common import DatasetOption, command_line, digests
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.cli.translation import TranslationOptions, require_steps, train_translator, translation_data
from dc2g_jax.datasets.houses import open_dataset


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Train the image-to-image translator on pairs of pictures (Algorithm 1, section III-B), training houses only.

    Attributes:
      out: folder for checkpoints, the network and the log.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      loss: mean absolute difference, a discriminator's doubt, or their sum weighted 100 to 1.
      seed: of weights, the order of the pairs and dropout.
      training: how it is trained.
      resume: go on with the run in `out`, begun with the same options, where it stopped; `steps` may have become more.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    dataset: DatasetOption = None
    loss: Literal["l1", "gan", "l1+gan"] = "l1+gan"
    seed: int = 0
    training: Annotated[TranslationOptions, tyro.conf.arg(name="")] = dataclasses.field(
        default_factory=TranslationOptions
    )
    resume: bool = False


def main(options: Options) -> None:
    """Make the pairs, train."""
    config = options.training.config(options.loss)
    dataset = open_dataset(options.dataset, cells=None)
    output_folder(
        options,
        "train_translator",
        free=("minutes_per_checkpoint", "steps"),
        inputs=digests(dataset),
        check=functools.partial(require_steps, options.training.steps),
    )
    data = translation_data(dataset, options.training)
    print(
        f"Training on {len(data.train.pair_house)} pairs of {len(data.train.terrain)} houses of {dataset.name}, "
        f"validating on {len(data.validation.pair_house)}"
    )
    train_translator(options.out, dataset, data, config, options.training, seed=options.seed)
    print(f"Trained: {options.out / 'network'}")


if __name__ == "__main__":
    command_line(Options, main)
