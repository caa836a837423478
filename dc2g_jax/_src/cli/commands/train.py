"""Train the cost-to-go network: `dc2g train --out checkpoints/mine`; or, with `--target steps`, the planner's score.

After an interruption, --resume continues where it stopped.
"""

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from dc2g_jax._src.cli.common import NetworkOption, digests
from dc2g_jax._src.cli.options import DataOptions, DatasetOptions, OptionalInt, TrainingOptions
from dc2g_jax._src.cli.outputs import command_written, commit, output_folder
from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.hub import local_folder
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import check_houses
from dc2g_jax._src.training.loop import Pauses
from dc2g_jax._src.training.losses import parse_losses
from dc2g_jax._src.training.score import ScoreConfig
from dc2g_jax._src.training.train import EPISODES_EVERY, Trained, train
from dc2g_jax._src.viewer.columns import viewer_sink
from dc2g_jax._src.viewer.training_recording import TrainingRecording, maps_to_watch, next_file, prediction_picture


@dataclasses.dataclass(frozen=True)
class Options(Pauses, DatasetOptions, TrainingOptions, DataOptions):
    """Train the cost-to-go network on training houses, with pairs of partial maps and exact cost-to-go (Algorithm 1).

    With `--target steps`, learn the cost of exploring from rollouts instead: the weights of the score by which `dc2g`
    chooses its subgoals in one field of view, for the network of --after. Of the other options below, this uses
    --rounds, --maps, --houses, --field-of-view, --split and --seed.

    Attributes:
      target: what to learn: the cost_to_go of every cell, or the steps that searches take.
      rounds: rounds of rollouts and fits, with --target steps; new weights are kept only if better on fresh maps.
      maps: maps without classes in a round, of each of two sizes; one decision in each.
      houses: procedural houses in a round.
      after: folder of a trained network, or hf://owner/name, to start from: training begins with its weights, and masks
        of robots that it leads are added to the others (DAgger).
      loss: quantile, l1, l2, huber or log, or package.module:Name for one of your own; or a weighted sum of them such
        as quantile=1,log=0.5.
      architecture: compact_unet, or package.module:Name for a network of your own, a subclass of flax.nnx.Module.
      patch: side of the square patches that the network splits a map into, in cells.
      embedding: number of hidden features of each patch; 0 for none.
      widths: channels at each scale, from the finest; each scale has half the resolution of the one before.
      quantiles: levels of the predicted quantiles: the middles of equal parts of the distribution, since planners treat
        the predictions as equally likely.
      steps: optimizer steps.
      batch_size: pairs per step; a multiple of 8 keeps up to eight CPU cores busy.
      learning_rate: peak learning rate.
      seed: seed of weights and batches.
      episodes_every: steps between validations that also run episodes in validation houses; 0 for none.
      split: split of the houses to run planners in at the end, with the trained network; None for no episodes.
      record: write a rerun recording of the training, `training-001.rrd`, and another one each time it is resumed;
        `rerun DIR/training-*.rrd` shows them together, even during training.
      connect: address of a running rerun viewer to send the training to, such as rerun+http://127.0.0.1:9876/proxy.
    """

    target: Literal["cost_to_go", "steps"] = "cost_to_go"
    rounds: int = ScoreConfig.rounds
    maps: int = ScoreConfig.maps
    houses: int = ScoreConfig.houses
    after: NetworkOption = None
    loss: str = "quantile"
    architecture: str = Architecture.network
    patch: int = Architecture.patch
    embedding: int = Architecture.embedding
    widths: tuple[int, ...] = Architecture.widths
    quantiles: tuple[float, ...] = Architecture.quantiles
    steps: int = TrainingConfig.steps
    batch_size: int = TrainingConfig.batch_size
    validate_every: OptionalInt = None
    learning_rate: float = TrainingConfig.learning_rate
    seed: int = 0
    split: Literal["train", "val", "test"] | None = "val"
    episodes_every: int = EPISODES_EVERY
    record: bool = False
    connect: Annotated[str | None, tyro.conf.arg(metavar="URL")] = None

    def training(self, side: int) -> TrainingConfig:
        """The training configuration for maps whose longer side has `side` cells.

        Raises:
          InputError: a number or a name is invalid.
        """
        count = len(self.quantiles)
        middles = [round((part + 0.5) / count, 3) for part in range(count)]
        if not np.allclose(self.quantiles, middles, atol=1e-3):
            raise InputError(
                f"--quantiles {' '.join(map(str, self.quantiles))}: planners treat the predictions as equally likely; "
                f"give the middles of equal parts, such as {' '.join(map(str, middles))}"
            )
        return TrainingConfig(
            architecture=Architecture(
                self.widths,
                self.quantiles,
                side=side,
                patch=self.patch,
                embedding=self.embedding,
                network=self.architecture,
            ),
            steps=self.steps,
            batch_size=self.batch_size,
            losses=parse_losses(self.loss),
            learning_rate=self.learning_rate,
            seed=self.seed,
        )


def shown_by(options: Options, config: TrainingConfig, dataset: HouseDataset) -> dict[str, Any]:
    """What shows the training on maps, as the options ask."""
    records = options.record or options.connect is not None
    if not records and options.track is None:
        return {}

    def recording() -> TrainingRecording:
        file = next_file(options.out) if options.record else None
        return TrainingRecording(options.out, config, maps_to_watch(dataset), file=file, viewer=options.connect)

    return {
        "recording": recording if records else None,
        "picture": lambda network: prediction_picture(network, maps_to_watch(dataset)),
    }


def main(options: Options) -> None:
    """Train, validate, save and evaluate the network, or learn its score."""
    learn = _learn_score if options.target == "steps" else _train_network
    trained = learn(options, open_dataset(options.dataset), {"command": command_written(), "commit": commit()})
    print(f"Trained: {options.out / 'network'}")
    if trained.results is not None:
        print(f"In the houses of split {options.split}:\n{trained.results}")


def _train_network(options: Options, dataset: HouseDataset, card: dict[str, Any]) -> Trained:
    config = options.training(max(dataset.houses[0].terrain.shape))
    shown = shown_by(options, config, dataset)
    if options.connect is not None:
        viewer_sink(options.connect)  # an invalid address raises before anything is written

    def begin() -> None:
        if shown:
            check_houses(dataset, extra=0, drawn=False, validated=True)
        network = None if options.after is None else network_in_folder(local_folder(options.after))
        free = {"validate_every", "episodes_every", "minutes_per_checkpoint", "record", "connect", "split"}
        output_folder(options, "train", free=free, inputs=digests(dataset, after=network))
        if shown:
            maps_to_watch(dataset)  # raises before minutes of other work

    return train(
        options.out, dataset, config=config, data=options.data,
        pauses=Pauses(options.validate_every, options.minutes_per_checkpoint), episodes_every=options.episodes_every,
        after=options.after, split=options.split, track=options.track, **shown, card=card, begin=begin,
    )  # fmt: skip


def _learn_score(options: Options, dataset: HouseDataset, card: dict[str, Any]) -> Trained:
    config = ScoreConfig(
        options.rounds, options.maps, options.houses, field_of_view=options.data.field_of_view, seed=options.seed
    )
    return train(
        options.out, dataset, config=config, after=options.after, split=options.split, card=card,
        begin=lambda: output_folder(options, "train", free={"split"}, inputs=digests(dataset)),
    )  # fmt: skip
