"""Train the cost-to-go network: `python -m experiments.train --out checkpoints/mine`.

After an interruption, --resume continues where it stopped.
"""

import contextlib
import dataclasses
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from dc2g_jax.cli.common import NetworkOption, command_line, digests
from dc2g_jax.cli.episodes import EpisodeProgress
from dc2g_jax.cli.options import DatasetOptions, TrainingOptions
from dc2g_jax.cli.outputs import WHERE, command_written, commit, output_folder
from dc2g_jax.cli.training_sets import open_training_set
from dc2g_jax.datasets.houses import HouseDataset, open_dataset
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import CARD, TrainingCheckpoints, load_network, newest_step, save_network
from dc2g_jax.estimation.compact_unet import Architecture
from dc2g_jax.estimation.estimators import NetworkCostToGo
from dc2g_jax.estimation.hub import local_folder
from dc2g_jax.files.reading import read_object
from dc2g_jax.inspection.columns import viewer_sink
from dc2g_jax.inspection.training_recording import TrainingRecording, maps_to_watch, next_file, prediction_picture
from dc2g_jax.rollouts.devices import first_copy, mesh_of, replicate, require_memory
from dc2g_jax.training.cost_to_go import (
    TrainingConfig,
    TrainingState,
    first_state,
    learning_rates,
    least_memory,
    train_step,
)
from dc2g_jax.training.cost_to_go_data import DataConfig, Validation, check_houses
from dc2g_jax.training.loop import Log, Losses, Pauses, Task, train
from dc2g_jax.training.losses import parse_losses

#: Number of maps in a recording, and in pictures for a tracker.
_MAPS_SHOWN = 6


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, TrainingOptions, Pauses):
    """Train the cost-to-go network on training houses, with pairs of partial maps and exact cost-to-go (Algorithm 1).

    Attributes:
      data: houses and masks.
      after: folder of a trained network, or hf://owner/name, to start from: training begins with its weights, and masks
        of robots that it leads are added to the others (DAgger).
      loss: quantile, l1, l2, huber or log, or package.module:Name for one of your own; or a weighted sum of them such
        as quantile=1,log=0.5.
      patch: side of the square patches that the network splits a map into, in cells.
      embedding: number of hidden features of each patch; 0 for none.
      widths: channels at each scale, from the finest; each scale has half the resolution of the one before.
      quantiles: levels of the predicted quantiles: the middles of equal parts of the distribution, since planners treat
        the predictions as equally likely.
      steps: optimizer steps.
      batch_size: pairs per step; a multiple of 8 keeps up to eight CPU cores busy.
      learning_rate: peak learning rate.
      seed: seed of weights and batches.
      record: write a rerun recording of the training, `training-001.rrd`, and another one each time it is resumed;
        `rerun DIR/training-*.rrd` shows them together, even during training.
      connect: address of a running rerun viewer to send the training to, such as rerun+http://127.0.0.1:9876/proxy.
    """

    data: tyro.conf.OmitArgPrefixes[DataConfig] = dataclasses.field(default_factory=DataConfig)
    after: NetworkOption = None
    loss: str = "quantile"
    patch: int = Architecture.patch
    embedding: int = Architecture.embedding
    widths: tuple[int, ...] = Architecture.widths
    quantiles: tuple[float, ...] = Architecture.quantiles
    steps: int = TrainingConfig.steps
    batch_size: int = TrainingConfig.batch_size
    learning_rate: float = TrainingConfig.learning_rate
    seed: int = 0
    validate_every: int = 16000
    minutes_per_checkpoint: float = 2.0
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
                self.widths, self.quantiles, side=side, patch=self.patch, embedding=self.embedding
            ),
            steps=self.steps,
            batch_size=self.batch_size,
            losses=parse_losses(self.loss),
            learning_rate=self.learning_rate,
            seed=self.seed,
        )


def compact_network(place: str | Path, architecture: Architecture) -> tuple[NetworkCostToGo, dict[str, Any]]:
    """A trained network of this architecture, and its card.

    Raises:
      InputError: the network has another architecture.
    """
    folder = local_folder(place)
    network = load_network(folder)
    if not isinstance(network, NetworkCostToGo) or network.architecture != architecture:
        raise InputError(
            f"{place}: is a network of another architecture; give --patch, --embedding, --widths and --quantiles as it "
            "was trained with, and maps of its size"
        )
    return network, read_object(folder / CARD, "give another network")


def model_card(
    options: Options, dataset: HouseDataset, after: dict[str, Any] | None, step: int, figures: dict[str, float]
) -> dict[str, Any]:
    """The card of a network: its origin and its validation metrics.

    Args:
      options: options of the command.
      dataset: the houses.
      after: card of the network that training started from.
      step: number of optimizer steps.
      figures: validation metrics.
    """
    data = options.data
    return {
        "data": f"{dataset.name}, training split, and {data.extra_houses} procedural houses (seed {data.data_seed})",
        "masks": f"rollouts of exploring robots with sensing ranges {', '.join(map(str, data.ranges))} cells"
        + ("" if after is None else ", and of robots led by the network below"),
        "target": "4-connected cost-to-go in cells",
        **({} if after is None else {"after": after}),
        "loss": options.loss,
        "command": command_written(),
        "commit": commit(),
        "devices": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
        "seed": options.seed,
        "steps": step,
        "validation": figures,
    }


def open_recording(options: Options, config: TrainingConfig, dataset: HouseDataset) -> TrainingRecording | None:
    """The recording, if the options ask for one. It shows validation houses, the same ones for every run."""
    if not options.record and options.connect is None:
        return None
    maps = maps_to_watch(dataset, _MAPS_SHOWN)
    file = next_file(options.out) if options.record else None
    return TrainingRecording(options.out, config, maps, file=file, viewer=options.connect)


def training_task(
    options: Options,
    config: TrainingConfig,
    dataset: HouseDataset,
    network: NetworkCostToGo | None,
    after: dict[str, Any] | None,
    recording: TrainingRecording | None,
) -> Task[TrainingState]:
    """The training task. It starts from `network`, if given, with the card `after`. Validations save the network."""
    recipe, hyperparameters, draw = config.recipe, config.hyperparameters, options.data.draw_batch
    # Raises before minutes of data collection.
    validation = Validation(dataset, progress=EpisodeProgress(leave=False)) if options.validate_every else None
    data = replicate(open_training_set(options.out, dataset, options.data, network), mesh_of())
    rates, maps = learning_rates(config), maps_to_watch(dataset, _MAPS_SHOWN) if options.track else None

    def init() -> TrainingState:
        state = first_state(config)
        if network is None:
            return state
        fresh = [jax.tree.map(jnp.array, network.weights) for _ in range(2)]  # steps donate their buffers
        return dataclasses.replace(state, weights=fresh[0], average=fresh[1])

    def network_of(state: TrainingState) -> NetworkCostToGo:
        return NetworkCostToGo(weights=first_copy(state.trained), architecture=config.architecture)

    def watch(state: TrainingState, step: int, loss: Losses | None) -> None:
        if recording is None:
            return
        if loss is None:
            recording.predict(step, network_of(state))
        else:
            recording.look(step, float(loss), network_of(state))

    def validate(state: TrainingState, step: int, loss: Losses | None) -> list[dict[str, Any]]:
        figures = validation.figures(network_of(state)) if validation else {}
        card = model_card(options, dataset, after, step, figures)
        save_network(options.out / "network", network_of(state), card)
        if recording is not None:
            recording.validate(step, figures, network_of(state))
        return [{"step": step, "loss": None if loss is None else round(float(loss), 4), **figures}]

    return Task(
        steps=config.steps,
        init=init,
        step=lambda state: train_step(state, hyperparameters, data, recipe=recipe, draw_batch=draw),
        validate=validate,
        validated=[
            step for step, line in Log(options.out).by_step().items() if "mean_extra" in line or validation is None
        ],
        watch=watch,
        learning_rate=lambda step: rates[step - 1],
        pictures=None if maps is None else lambda state: [prediction_picture(network_of(state), maps)],
    )


def main(options: Options) -> None:
    """Train, validate and save the network."""
    options.check_pauses()
    dataset = open_dataset(options.dataset)
    config = options.training(max(dataset.houses[0].terrain.shape))
    network, after = (None, None) if options.after is None else compact_network(options.after, config.architecture)
    if options.connect is not None:
        viewer_sink(options.connect)  # an invalid address raises before anything is written
    watched = options.validate_every > 0 or options.record or options.connect is not None or options.track is not None
    check_houses(dataset, extra=options.data.extra_houses, drawn=options.validate_every > 0, validated=watched)
    free = {"validate_every", "minutes_per_checkpoint", "record", "connect"}
    require_memory(least_memory(config, *dataset.houses[0].terrain.shape), f"--batch-size {config.batch_size}")
    output_folder(options, "train", free=free, inputs=digests(dataset, after=network))
    apart = {*WHERE, "dataset", *free}
    facts = {name: value for name, value in dataclasses.asdict(options).items() if name not in apart}
    facts["after"] = None if options.after is None else str(options.after)
    facts |= {"dataset": dataset.name, "parts": config.parts}
    recording = open_recording(options, config, dataset) if newest_step(options.out) < config.steps else None
    with contextlib.closing(recording) if recording else contextlib.nullcontext():
        task = training_task(options, config, dataset, network, after, recording)
        checkpoints = TrainingCheckpoints(options.out, config, facts, first_state=first_state)
        train(task, options.out, checkpoints, options, options.track)
    print(f"Trained: {options.out / 'network'}")


if __name__ == "__main__":
    command_line(Options, main)
