"""Train a network from start to end: collect observation masks, train, validate, save, and evaluate."""

import contextlib
import dataclasses
import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.checkpoints import CARD, TrainingCheckpoints, network_in_folder, save_network
from dc2g_jax._src.estimation.compact_unet import Architecture, check_network
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.hub import local_folder
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import usable_houses
from dc2g_jax._src.rollouts.devices import first_copy, mesh_for_batch, replicate, require_memory
from dc2g_jax._src.rollouts.evaluation import evaluate
from dc2g_jax._src.rollouts.progress import EpisodeProgress
from dc2g_jax._src.rollouts.results import Results
from dc2g_jax._src.training import loop
from dc2g_jax._src.training.cost_to_go import (
    CostToGoTraining,
    TrainingConfig,
    first_state,
    learning_rates,
    least_memory,
)
from dc2g_jax._src.training.cost_to_go_data import DataConfig, Validation, check_houses, open_training_set
from dc2g_jax._src.training.loop import Log, Losses, Pauses, Task
from dc2g_jax._src.training.losses import losses_as_text
from dc2g_jax._src.training.step import TrainingState, placed, supervised_step
from dc2g_jax._src.training.tracking import Image, TrackerName

#: When a training validates and saves unless it is told.
PAUSES = Pauses(validate_every=16000, minutes_per_checkpoint=2.0)


class Recording(Protocol):
    """Shows a training, see `viewer.training_recording.TrainingRecording`."""

    def look(self, step: int, loss: float | None, network: NetworkCostToGo) -> None:
        """Show a loss, and predictions; predictions alone before the first step."""
        ...

    def validate(self, step: int, figures: Mapping[str, float], network: NetworkCostToGo) -> None:
        """Show the results of a validation."""
        ...

    def close(self) -> None:
        """Called at the end."""
        ...


@dataclasses.dataclass(frozen=True)
class Watching:
    """What shows a training. It does not affect it.

    Attributes:
      recording: gets losses, predictions and validations.
      picture: makes a picture of a network's predictions for a tracker.
      track: tracker to send curves and pictures to.
      card: further facts for the card of the network, such as the command.
    """

    recording: Recording | None = None
    picture: Callable[[NetworkCostToGo], Image] | None = None
    track: TrackerName | None = None
    card: Mapping[str, Any] = dataclasses.field(default_factory=dict)


#: Called when everything has been checked and nothing is written yet: `(dataset, config, network to begin with)`.
Begin = Callable[[HouseDataset, TrainingConfig, NetworkCostToGo | None], Watching]


class Trained(NamedTuple):
    """What `train` gives.

    Attributes:
      network: the trained network, which is also in the folder `network`.
      results: episodes of `frontier` and of `dc2g` with it; `None` without a split.
    """

    network: NetworkCostToGo
    results: Results | None


def _network_to_begin_with(
    place: str | os.PathLike[str], architecture: Architecture
) -> tuple[NetworkCostToGo, dict[str, Any]]:
    """A trained network of this architecture, and its card.

    Raises:
      InputError: the network has another architecture.
    """
    folder = local_folder(place)
    network = network_in_folder(folder)
    if not isinstance(network, NetworkCostToGo) or network.architecture != architecture:
        raise InputError(
            f"{place}: is a network of another architecture; give --architecture, --patch, --embedding, --widths and "
            "--quantiles as it was trained with, and maps of its size"
        )
    return network, read_object(folder / CARD, "give another network")


def train(
    out: str | os.PathLike[str],
    dataset: HouseDataset | str | os.PathLike[str] | None = None,
    *,
    config: TrainingConfig | None = None,
    data: DataConfig | None = None,
    pauses: Pauses = PAUSES,
    after: str | os.PathLike[str] | None = None,
    split: str | None = "val",
    begin: Begin = lambda dataset, config, network: Watching(),
) -> Trained:
    """Train a cost-to-go network with pairs of partial maps and exact cost-to-go (Algorithm 1), and evaluate it.

    Masks, checkpoints, log, curve and network are written to the folder. A training that stopped goes on from its last
    checkpoint; one that is finished is evaluated only. `dc2g train` is a call of this function.

    ```
    trained = dc2g_jax.train("checkpoints/mine", "procedural", config=dc2g_jax.TrainingConfig(steps=2000))
    print(trained.results)
    ```

    Args:
      out: folder of the training.
      dataset: houses, a folder of them, or a name such as `procedural`; `None` for the published ones, see
        `open_dataset`.
      config: network, losses and steps. The side of its architecture becomes that of the dataset's maps.
      data: houses and masks.
      pauses: when to validate and to save.
      after: folder of a trained network, or hf://owner/name, to begin with. Masks of robots that it leads are added to
        the others (DAgger).
      split: split of the houses to evaluate in at the end, ten starts in each: `train`, `val` or `test`; `None` for no
        evaluation.
      begin: see `Begin`; returns what shows the training.

    Raises:
      InputError: a setting is invalid, the dataset cannot be trained on, or the folder holds a training with other
        settings.
    """
    keep_compiled_programs()
    out = Path(out)
    pauses.check_pauses()
    if not isinstance(dataset, HouseDataset):
        dataset = open_dataset(dataset)
    config, data, shape = config or TrainingConfig(), data or DataConfig(), dataset.houses[0].terrain.shape
    config = dataclasses.replace(config, architecture=dataclasses.replace(config.architecture, side=max(shape)))
    check_network(config.architecture)
    network, before = (None, None) if after is None else _network_to_begin_with(after, config.architecture)
    require_memory(least_memory(config, *shape), f"--batch-size {config.batch_size}")
    check_houses(dataset, extra=data.extra_houses, drawn=pauses.validate_every > 0, validated=pauses.validate_every > 0)
    if split is not None:
        usable_houses(dataset, split, instead="use another split")
    watching = begin(dataset, config, network)
    facts = {
        "data": dataclasses.asdict(data),
        "after": None if after is None else str(after),
        "dataset": dataset.name,
        "parts": config.parts,
    }
    card = {
        "data": f"{dataset.name}, training split, and {data.extra_houses} procedural houses (seed {data.data_seed})",
        "masks": f"rollouts of exploring robots with sensing ranges {', '.join(map(str, data.ranges))} cells"
        + ("" if before is None else ", and of robots led by the network below"),
        "target": "4-connected cost-to-go in cells",
        **({} if before is None else {"after": before}),
        "loss": losses_as_text(config.losses),
        "devices": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
        "seed": config.seed,
        **watching.card,
    }
    with contextlib.closing(watching.recording) if watching.recording else contextlib.nullcontext():
        begun = functools.partial(_begun, network=network)
        checkpoints = TrainingCheckpoints(out, config, facts, first_state=begun)
        task = _task(out, dataset, config, data, pauses, network, card, watching)
        state = loop.fit(task, out, checkpoints, pauses, watching.track)
    trained = _network_of(state, config)
    return Trained(
        trained, None if split is None else evaluate(["frontier", "dc2g"], dataset, split=split, network=trained)
    )


def _begun(config: TrainingConfig, network: NetworkCostToGo | None) -> TrainingState:
    """The state before the first step, with the weights of `network`, if given."""
    state = first_state(config)
    if network is None:
        return state
    fresh = [jax.tree.map(jnp.array, network.weights) for _ in range(2)]  # steps donate their buffers
    return dataclasses.replace(state, weights=fresh[0], average=fresh[1])


def _network_of(state: TrainingState, config: TrainingConfig) -> NetworkCostToGo:
    return NetworkCostToGo(weights=first_copy(state.trained), architecture=config.architecture)


def _task(
    out: Path,
    dataset: HouseDataset,
    config: TrainingConfig,
    data: DataConfig,
    pauses: Pauses,
    network: NetworkCostToGo | None,
    card: Mapping[str, Any],
    watching: Watching,
) -> Task[TrainingState]:
    """The training task, with masks of robots that `network` leads, if given. Validations save the network's card."""
    training, hyperparameters = CostToGoTraining(config.recipe, data.draw_batch), config.hyperparameters
    recording, mesh = watching.recording, mesh_for_batch(config.batch_size)
    # Raises before minutes of data collection.
    validation = Validation(dataset, progress=EpisodeProgress(leave=False)) if pauses.validate_every else None
    pairs = replicate(open_training_set(out, dataset, data, network), mesh)
    rates, picture = learning_rates(config), watching.picture

    validated = [step for step, line in Log(out).by_step().items() if "mean_extra" in line or validation is None]

    def watch(state: TrainingState, step: int, loss: Losses | None) -> None:
        if recording is not None:
            recording.look(step, None if loss is None else float(loss), _network_of(state, config))

    def validate(state: TrainingState, step: int, loss: Losses | None) -> list[dict[str, Any]]:
        now = _network_of(state, config)
        figures = validation.figures(now) if validation else {}
        save_network(out / "network", now, {**card, "steps": step, "validation": figures})
        if recording is not None:
            recording.validate(step, figures, now)
        return [{"step": step, "loss": None if loss is None else round(float(loss), 4), **figures}]

    return Task(
        steps=config.steps,
        step=lambda state: supervised_step(state, pairs, hyperparameters, training=training, mesh=mesh),
        place=functools.partial(placed, mesh=mesh),
        validate=validate,
        validated=validated if (out / "network").exists() else (),  # else the network is written again
        watch=watch,
        learning_rate=lambda step: rates[step - 1],
        pictures=None if picture is None else lambda state: [picture(_network_of(state, config))],
    )
