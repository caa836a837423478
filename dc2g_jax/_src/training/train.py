"""Train a network from start to end: collect observation masks, train, validate, save, and evaluate."""

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

from dc2g_jax._src.estimation.checkpoints import (
    CARD,
    SHIPPED_NETWORK,
    keep_config,
    network_in_folder,
    newest_step,
    save_network,
)
from dc2g_jax._src.estimation.compact_unet import Architecture, check_network
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.hub import local_folder
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid.sensing import PAPER_DEGREES
from dc2g_jax._src.planning.learned_score import TERMS
from dc2g_jax._src.readers.houses import SPLITS, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import usable_houses
from dc2g_jax._src.rollouts.evaluation import evaluate
from dc2g_jax._src.rollouts.results import Results
from dc2g_jax._src.runtime.devices import require_memory
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig, least_memory, validation_error
from dc2g_jax._src.training.cost_to_go_data import (
    DataConfig,
    check_houses,
    episodes_to_validate,
    open_training_set,
    validation_pairs,
)
from dc2g_jax._src.training.loop import PAUSES, Pauses, Recording, Task, fit
from dc2g_jax._src.training.losses import LOSSES, Loss, loss_sha256, losses_as_text, named_loss
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax._src.training.score import ScoreConfig, learn_score
from dc2g_jax._src.training.tracking import Image, TrackerName, check_tracker, run_folder

#: Steps between episodes in validation houses.
EPISODES_EVERY = 16_000

#: Makes a picture of a network's predictions for a tracker.
Picture = Callable[[NetworkCostToGo], Image]


class Trained(NamedTuple):
    """What `train` gives.

    Attributes:
      network: the trained network, which is also in the folder `network`.
      results: episodes of `frontier` and of `dc2g` with it; `None` without a split.
    """

    network: NetworkCostToGo
    results: Results | None


class Plan(NamedTuple):
    """A checked training of cost-to-go networks.

    Attributes:
      dataset: the houses.
      runs: the configuration of each run by its name, for maps of the dataset's size.
      data: houses and masks.
      losses: losses by their names in the configurations.
      pauses: when to validate and to save.
      track: tracker to send the curves to.
      after: place of the network that the runs begin with.
    """

    dataset: HouseDataset
    runs: Mapping[str, TrainingConfig]
    data: DataConfig
    losses: Mapping[str, Loss]
    pauses: Pauses
    track: TrackerName | None
    after: str | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """What must be the same to resume the runs, beside their configurations."""
        own = {name: loss_sha256(loss) for name, loss in self.losses.items() if name not in LOSSES}
        return {
            "data": dataclasses.asdict(self.data),
            "after": self.after,
            "dataset": self.dataset.name,
            "parts": self.recipe.parts,
            **({"losses_sha256": own} if own else {}),
        }

    @property
    def recipe(self) -> TrainingConfig:
        """What the runs have in common."""
        return next(iter(self.runs.values()))


def checked(
    dataset: HouseDataset | str | os.PathLike[str] | None,
    runs: Mapping[str, TrainingConfig],
    *,
    data: DataConfig | None,
    pauses: Pauses,
    split: str | None,
    track: TrackerName | None,
    validated: bool,
    drawn: bool = False,
    own_losses: Mapping[str, Loss] | None = None,
    at_once: int = 1,
) -> Plan:
    """Check all names, numbers and houses of a training, before anything is written or computed.

    `validated` and `drawn` tell whether validation houses of the dataset, and procedural ones, are used; `at_once` how
    many runs are trained together.

    Raises:
      InputError: something is invalid.
    """
    pauses.check_pauses()
    check_tracker(track)
    if split is not None:
        check_name("split", split, SPLITS)
    names = dict.fromkeys(name for config in runs.values() for name, _ in config.losses)
    losses = {name: (own_losses or {}).get(name) or named_loss(name) for name in names}
    if not isinstance(dataset, HouseDataset):
        dataset = open_dataset(dataset)
    shape = dataset.houses[0].terrain.shape
    sized = {
        run: dataclasses.replace(config, architecture=dataclasses.replace(config.architecture, side=max(shape)))
        for run, config in runs.items()
    }
    for architecture in dict.fromkeys(config.architecture for config in sized.values()):
        check_network(architecture)
    config = max(sized.values(), key=lambda config: least_memory(config, *shape))
    needed = min(at_once, len(runs)) * least_memory(config, *shape)
    require_memory(needed, f"--batch-size {config.batch_size}" + f" or --runs-at-once {at_once}" * (at_once > 1))
    data = (data or DataConfig()).for_steps(config.steps)
    check_houses(dataset, extra=data.extra_houses or 0, drawn=drawn, validated=validated)
    if split is not None:
        usable_houses(dataset, split, instead="use another split")
    return Plan(dataset, sized, data, losses, pauses, track)


def train_runs(
    out: Path,
    plan: Plan,
    data: TrainingSet,
    validate: Callable[[NetworkCostToGo, int], Mapping[str, Any]],
    *,
    card: Mapping[str, Any] | None,
    picture: Picture | None,
    **options: Any,
) -> list[NetworkCostToGo]:
    """Train the networks of a plan, together if there are several, and save them at each validation.

    The runs of the plan only differ in hyperparameters. `validate` makes figures of `(network, step)`, `card` has
    further facts for the card of each network, and `options` are further attributes of the `Task`.
    """
    recipe = plan.recipe.recipe

    def network_of(weights: Any) -> NetworkCostToGo:
        return NetworkCostToGo(weights=weights, architecture=recipe.architecture)

    def save(folder: Path, weights: Any, figures: dict[str, Any]) -> None:
        config = next(config for run, config in plan.runs.items() if run_folder(out, run) == folder)
        made = {
            "data": f"{plan.dataset.name}, training split, and {plan.data.extra_houses} procedural houses (seed "
            f"{plan.data.data_seed})",
            "masks": f"rollouts of exploring robots with sensing ranges {', '.join(map(str, plan.data.ranges))} cells"
            + (f" and {degrees:g} degrees" if (degrees := plan.data.field_of_view) != PAPER_DEGREES else ""),
            "target": "4-connected cost-to-go in cells",
            "loss": losses_as_text(config.losses),
            "learning_rate": config.learning_rate,
            "devices": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
            "seed": config.seed,
        }
        save_network(folder / "network", network_of(weights), {**made, **(card or {}), **figures})

    task = Task(
        training=CostToGoTraining(recipe, plan.data.draw_batch, tuple(plan.losses.items())),
        data=data,
        runs=plan.runs,
        steps=recipe.steps,
        validate=lambda weights, step: validate(network_of(weights), step),
        save=save,
        facts=plan.facts,
        picture=None if picture is None else lambda weights: picture(network_of(weights)),
        **options,
    )
    return [network_of(weights) for weights in fit(task, out, plan.pauses, plan.track)]


def error_on(pairs: Any, network: NetworkCostToGo) -> float:
    """Mean error of a network on validation pairs, in cells."""
    return round(float(validation_error(network.architecture, network.weights, pairs)), 4)


def finished_network(out: Path, plan: Plan, run: str) -> NetworkCostToGo | None:
    """The network of a run that has taken all its steps; `None` before that, when its configuration is saved.

    Raises:
      InputError: the folder holds a run of another configuration.
    """
    folder, config = run_folder(out, run), plan.runs[run]
    keep_config(folder, config, plan.facts)
    path = folder / "network"
    if newest_step(folder) < config.steps or not (path / CARD).exists():  # the last state is saved after all else
        return None
    network = network_in_folder(path)
    return network if isinstance(network, NetworkCostToGo) else None


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
    config: TrainingConfig | ScoreConfig | None = None,
    data: DataConfig | None = None,
    pauses: Pauses = PAUSES,
    episodes_every: int = EPISODES_EVERY,
    after: str | os.PathLike[str] | None = None,
    split: str | None = "val",
    track: TrackerName | None = None,
    recording: Callable[[], Recording] | None = None,
    picture: Picture | None = None,
    card: Mapping[str, Any] | None = None,
    begin: Callable[[], object] | None = None,
) -> Trained:
    """Train a cost-to-go network with pairs of partial maps and exact cost-to-go (Algorithm 1), and evaluate it.

    With a `ScoreConfig`, learn the cost of exploring from rollouts instead (see `training.score`): the weights of the
    score by which `dc2g` chooses its subgoals, for the network of `after`.

    Masks, checkpoints, log, curve and network are written to the folder. A training that stopped goes on from its last
    checkpoint; one that is finished is evaluated only. `dc2g train` is a call of this function; `sweep` trains many.

    ```
    trained = dc2g_jax.train("checkpoints/mine", "procedural", config=dc2g_jax.TrainingConfig(steps=2000))
    print(trained.results)
    ```

    Args:
      out: folder of the training.
      dataset: houses, a folder of them, or a name such as `procedural`; `None` for the published ones, see
        `open_dataset`.
      config: network, losses and steps. The side of its architecture becomes that of the dataset's maps. Or how to
        learn the score; then only `dataset`, `after`, `split`, `card` and `begin` are used.
      data: houses and masks; by default fewer for fewer steps.
      pauses: when to validate, on pairs of validation houses, and to save; by default six times, and every two
        minutes.
      episodes_every: steps between validations that also run episodes in validation houses; 0 for none.
      after: folder of a trained network, or hf://owner/name, to begin with. Masks of robots that it leads are added to
        the others (DAgger).
      split: split of the houses to evaluate in at the end, ten starts in each: `train`, `val` or `test`; `None` for no
        evaluation.
      track: tracker to send curves and pictures to: `tensorboard`, `wandb` or `trackio`.
      recording: makes what shows the training, a `dc2g_jax.training.Recording`; not called if all steps are taken.
      picture: makes the pictures for the tracker.
      card: further facts for the card of the network.
      begin: called when all is checked, before anything is computed or written.

    Raises:
      InputError: a setting is invalid, the dataset cannot be trained on, or the folder holds a training with other
        settings.
    """
    keep_compiled_programs()
    out = Path(out)
    if isinstance(config, ScoreConfig):
        if split is not None:
            check_name("split", split, SPLITS)
            dataset = dataset if isinstance(dataset, HouseDataset) else open_dataset(dataset)
            usable_houses(dataset, split, instead="use another split")
        return _evaluated(_score_learned(out, config, after, dict(card or {}), begin), dataset, split)
    config = config or TrainingConfig()
    check_number("--episodes-every", episodes_every, whole=True, least=0, hint="steps (0 for none)")
    validates = pauses.steps_between(config.steps) > 0
    runs_episodes = validates and 0 < episodes_every <= config.steps
    plan = checked(
        dataset, {"": config}, data=data, pauses=pauses, split=split, track=track, validated=validates,
        drawn=runs_episodes,
    )  # fmt: skip
    config, dataset = plan.recipe, plan.dataset
    begin_with: NetworkCostToGo | None = None
    if after is not None:
        begin_with, before = _network_to_begin_with(after, config.architecture)
        plan, card = plan._replace(after=str(after)), {"after": before, **(card or {})}
    if begin is not None:
        begin()
    network = finished_network(out, plan, "")
    if network is None:
        # These raise for unsuitable houses before minutes of data collection.
        pairs = validation_pairs(dataset, edge_weight=plan.data.edge_weight) if validates else None
        episodes = episodes_to_validate(dataset, EpisodeProgress(leave=False)) if runs_episodes else None

        def validate(network: NetworkCostToGo, step: int) -> dict[str, Any]:
            figures = {} if pairs is None else {"error": error_on(pairs, network)}
            return figures | (episodes(network) if episodes and step % episodes_every == 0 else {})

        (network,) = train_runs(
            out, plan, open_training_set(out, dataset, plan.data, begin_with), validate,
            card=card, picture=picture,
            recording=recording() if recording is not None and newest_step(out) < config.steps else None,
            begin_with=None if begin_with is None else begin_with.weights,
        )  # fmt: skip
    return _evaluated(network, dataset, split)


def _evaluated(network: NetworkCostToGo, dataset: Any, split: str | None) -> Trained:
    """The network, and its planner's episodes in a split."""
    return Trained(
        network, None if split is None else evaluate(["frontier", "dc2g"], dataset, split=split, network=network)
    )


def _score_learned(
    out: Path,
    config: ScoreConfig,
    after: str | os.PathLike[str] | None,
    card: dict[str, Any],
    begin: Callable[[], object] | None,
) -> NetworkCostToGo:
    """A trained network with a score learned for it, saved in the folder `network`."""
    folder = resource(SHIPPED_NETWORK) if after is None else local_folder(after)
    network, before = network_in_folder(folder), read_object(folder / CARD, "give another network")
    if not isinstance(network, NetworkCostToGo):
        raise InputError(f"{after}: is no cost-to-go network in cells; give one of `dc2g train`")
    if begin is not None:
        begin()
    keep_config(out, config, {"after": before["sha256"], "terms": TERMS})
    last, made = learn_score(out, network, config)[-1], out / "network"
    if not (made / CARD).exists():
        view, how = f"{config.field_of_view:g}", {**dataclasses.asdict(config), **card}
        for fact, new in (("score", last.weights), ("score_training", how)):
            before[fact] = {**before.get(fact, {}), view: new}
        save_network(made, network, before)
    return network_in_folder(made)
