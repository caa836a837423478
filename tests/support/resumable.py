"""The commands that can be resumed, small enough to be run thousands of times.

What takes long and writes nothing, such as episodes, steps of training and figures, is replaced by a stand-in. What is
written, when and where is the command's own doing.
"""

import dataclasses
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.cli import episodes
from dc2g_jax._src.cli.commands import compare, run_episodes, sweep, train
from dc2g_jax._src.estimation.checkpoints import network_in_folder, write_network
from dc2g_jax._src.estimation.weights import fresh_weights
from dc2g_jax._src.grid.terrain import GRASS
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import EpisodeResult, Results
from dc2g_jax._src.training import cost_to_go_data, loop, sweeps, train as training
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.loop import Task
from dc2g_jax._src.training.masks import Masks
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, SmallEncoder
from dc2g_jax.indoor.search.evaluation import SearchResult
from experiments import (
    head_to_head,
    noisy_mapping,
    objectnav_table1,
    objectnav_table2,
    objectnav_train,
    reproduce_fig5,
    reproduce_fig7,
)
from experiments.objectnav.collecting import CollectionConfig
from experiments.objectnav.losses import OF_CLASSES
from experiments.objectnav_table2 import METRICS
from experiments.studies import unknown_dimensions
from experiments.support import published, searches
from experiments.support.driving import DriveResult
from experiments.support.published import PUBLISHED_GROUPS
from tests.support import trainings
from tests.support.houses import STREET, YARD
from tests.support.two_rooms import AGENT, two_rooms

#: Runs a command, resumed or not, that writes to this folder.
Command = Callable[[Path, bool], None]

#: Starts in the house of the split `test`.
STARTS = [Start("test", column, 4, 0) for column in (1, 2, 3)]

SMALL_ENCODER = EncoderArchitecture((2, 2, 2), features=2)


def write_houses(folder: Path) -> None:
    """A map of ten by ten cells of every split."""
    for split, terrain in (("train", STREET), ("val", YARD), ("test", STREET[:, ::-1])):
        (folder / split).mkdir(parents=True)
        np.save(folder / split / f"{split}.npy", np.pad(terrain, ((0, 2), (0, 0)), constant_values=GRASS))


def fake_episodes(self, starts, planners, estimator=None) -> list[EpisodeResult]:
    """Stands in for `Runner.run`: the farther right the start, the longer the episode."""
    return [
        EpisodeResult(
            *start[:4], self.rules(start).sensing.radius, self.rules(start).expanding_range, planner, True, start.x + 2,
            2, 50.0 * start.x, "to_goal", "F" * (start.x + 2),
        )
        for planner in planners
        for start in starts
    ]  # fmt: skip


def fake_step(state, *args, **options) -> tuple[Any, jax.Array]:
    """Stands in for a step of training: other weights after each step."""
    names = {"weights", "average", "generator"} & {field.name for field in dataclasses.fields(state)}
    step = np.max(state.step)
    changed = {name: jax.tree.map(lambda leaf: 0.5 * leaf + 0.1 * step, getattr(state, name)) for name in names}
    return dataclasses.replace(state, step=state.step + 1, **changed), jnp.full(state.step.shape, 0.5)


def fake_masks(config, houses, n_own, on_progress, network) -> Masks:
    """Stands in for `observation_masks`."""
    return Masks(boards=np.ones((2, 1, 10), np.uint32), world=np.zeros(2, np.int32))


def fake_training_set(houses, n_own, masks) -> TrainingSet:
    """Stands in for `training_set`, without labels."""
    terrain, world = np.stack([house.terrain for house in houses]), masks.world
    return TrainingSet(terrain, np.zeros(terrain.shape, np.float32), masks.boards, world, np.int32(len(world)))


def fake_episodes_to_validate(dataset, progress) -> Callable[[Any], dict[str, float]]:
    """Stands in for `episodes_to_validate`; the figures depend on the weights."""
    return lambda estimator: {"mean_extra": float(np.sum(jax.tree.leaves(estimator.weights)[0]))}


def fake_figure(path, *args, **options) -> list[Path]:
    """Stands in for a function that draws."""
    written = [Path(f"{path}{ending}") for ending in (".png", ".svg")]
    for target in written:
        target.write_text("a figure")
    return written


def fake_encoder_task(training, views, card) -> Task:
    """Stands in for `encoder_task`."""

    def save(folder, weights, facts):
        write_network(folder, weights, SMALL_ENCODER, ENCODER, facts)

    return Task(training, None, {"": training}, training.steps, lambda weights, step: {"error": 0.5}, save)


def fake_results(name, houses, some_searches, searches) -> list[SearchResult]:
    """Stands in for `results_of`."""
    return [SearchResult(*search, name, True, True, 0.5, 1.0, 2.0, 0.0, 20, 0, 0.1, 0.1, 0.1, 0.1) for search in
            some_searches]  # fmt: skip


def _command(module: Any, options: Any) -> Command:
    return lambda out, resume: module.main(dataclasses.replace(options, out=out, resume=resume))


def _episodes(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Runner, "run", fake_episodes)
    patch.setattr(episodes, "EPISODES_A_SHARD", 2)


def _published(patch: pytest.MonkeyPatch, module: Any) -> None:
    """Call the houses the published ones, and some episodes in them the paper's."""
    _episodes(patch)
    groups = PUBLISHED_GROUPS[:-1]
    steps = {"oracle": 5, "frontier": 9, "dc2g": 7}
    ran = [(start, group, steps) for group in groups for start in STARTS[:2]]
    open_dataset = module.open_dataset
    patch.setattr(module, "open_dataset", lambda where: dataclasses.replace(open_dataset(where), source="published"))
    for each in (module, episodes, published):
        patch.setattr(each, "published_episodes", lambda: ran, raising=False)


def run_episodes_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _episodes(patch)
    starts = folder / "starts.csv"
    starts.write_text("\n".join(["house,x,y,heading", *(",".join(map(str, start[:4])) for start in STARTS)]))
    return _command(run_episodes, run_episodes.Options(starts=starts, dataset=dataset, planner=("oracle", "frontier")))


def reproduce_fig7_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _published(patch, reproduce_fig7)
    patch.setattr(reproduce_fig7, "plot_extra_steps", fake_figure)
    patch.setattr(reproduce_fig7, "plot_results", lambda results, path, *args: fake_figure(path))
    planners = ("oracle", "frontier", "true_cost_to_go")
    return _command(reproduce_fig7, reproduce_fig7.Options(dataset=dataset, planner=planners, starts_per_house=3))


def head_to_head_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _published(patch, head_to_head)
    patch.setattr(head_to_head, "plot_head_to_head", fake_figure)
    return _command(head_to_head, head_to_head.Options(dataset=dataset, planner="true_cost_to_go", resamples=20))


def compare_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _episodes(patch)
    patch.setattr(compare, "plot_leaderboard", fake_figure)
    return _command(compare, compare.Options(family=(dataset,), planner=("frontier", "random_frontier"), starts=3))


def unknown_dimensions_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _episodes(patch)
    worlds = unknown_dimensions.Worlds([House("test", "val", STREET)], STARTS)
    patch.setattr(unknown_dimensions, "all_worlds", lambda options, dataset: {"one": worlds, "other": worlds})
    network = network_in_folder()
    patch.setattr(unknown_dimensions, "load_network", lambda place: network)
    patch.setattr(unknown_dimensions, "milliseconds", lambda estimators, house: {})
    return _command(unknown_dimensions, unknown_dimensions.Options(dataset=dataset))


def noisy_mapping_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    def drive_all(noise, houses, starts, **options) -> list[DriveResult]:
        return [DriveResult(*start[:4], 5.0 + noise, "arrived", 0.0, 0.0) for start in starts]

    _episodes(patch)
    network = network_in_folder()
    patch.setattr(noisy_mapping, "load_network", lambda place: network)
    patch.setattr(noisy_mapping, "equipment", lambda planner, network, size, noise, options: noise)
    patch.setattr(noisy_mapping, "drive_all", drive_all)
    patch.setattr(noisy_mapping, "plot_noise", fake_figure)
    return _command(noisy_mapping, noisy_mapping.Options(dataset=dataset, starts_per_house=2, levels=(0.0, 1.0)))


def _tables(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(searches, "indoor_houses", lambda *args, **options: [two_rooms()])
    patch.setattr(searches, "search_all", lambda *args, **options: None)
    patch.setattr(searches, "results_of", fake_results)


def objectnav_table1_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _tables(patch)
    agents = ("random", "frontier")
    return _command(objectnav_table1, objectnav_table1.Options(count=1, episodes=2, agents=agents, resamples=20))


def objectnav_table2_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _tables(patch)
    patch.setattr(objectnav_table2, "open_networks", lambda folders: {"semantic": None, "both": None})
    patch.setattr(objectnav_table2, "agent_with", lambda *args, **options: AGENT)
    metrics = dict.fromkeys((*METRICS, *OF_CLASSES), 50.0)
    patch.setattr(objectnav_table2, "prediction_metrics", lambda *args: metrics)
    return _command(objectnav_table2, objectnav_table2.Options(count=1, episodes=2, resamples=20))


#: First states by configuration, since they take long to make.
_FIRST_STATES: dict[Any, Any] = {}


def _first_state(begun: Callable[[Any, Any], Any], task: Task, config: Any) -> Any:
    if config not in _FIRST_STATES:
        _FIRST_STATES[config] = begun(task, config)
    return _FIRST_STATES[config]


def _steps(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(loop, "supervised_step", fake_step)
    patch.setattr(loop, "_begun", lambda task, config, begun=loop._begun: _first_state(begun, task, config))


def _training(patch: pytest.MonkeyPatch) -> None:
    _steps(patch)
    patch.setattr(training, "episodes_to_validate", fake_episodes_to_validate)
    for module in (training, sweeps):
        patch.setattr(module, "validation_pairs", lambda *args, **options: None)
    patch.setattr(cost_to_go_data, "observation_masks", fake_masks)
    patch.setattr(cost_to_go_data, "training_set", fake_training_set)


def train_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _training(patch)
    patch.setattr(training, "error_on", lambda pairs, network: float(np.sum(jax.tree.leaves(network.weights)[0])))
    options = train.Options(
        dataset=dataset, out=folder, data=DataConfig(extra_houses=0), widths=(2, 2, 2, 2), steps=3, batch_size=1,
        validate_every=1, episodes_every=2, minutes_per_checkpoint=0.0, split=None,
    )  # fmt: skip
    return _command(train, options)


def sweep_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    def fake_evaluate(planners, dataset, network, **options):
        robots = types.SimpleNamespace(rules=lambda start: SETTINGS["paper"].rules())
        return Results(fake_episodes(robots, STARTS, planners))

    _training(patch)
    patch.setattr(sweeps, "error_on", lambda pairs, network: float(np.sum(jax.tree.leaves(network.weights)[0])))
    patch.setattr(sweeps, "evaluate", fake_evaluate)
    patch.setattr(sweep, "plot_sweep", lambda result, path: fake_figure(path))
    options = sweep.Options(
        dataset=dataset, out=folder, data=DataConfig(extra_houses=0), widths=("2,2,2,2",), losses=("l1",), seeds=(0, 1),
        steps=2, batch_size=1, validate_every=1, minutes_per_checkpoint=0.0,
    )  # fmt: skip
    return _command(sweep, options)


def reproduce_fig5_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    _steps(patch)
    patch.setattr(reproduce_fig5, "metrics_over_pairs", lambda network, data: {"l1": 0.25, "low_recall": 0.5})
    data = reproduce_fig5.TranslationData(trainings.image_set(), trainings.image_set())
    patch.setattr(reproduce_fig5, "translation_data", lambda dataset, options: data)
    patch.setattr(reproduce_fig5, "plot_training", fake_figure)
    options = reproduce_fig5.Options(
        dataset=dataset, out=folder, losses=("l1",), seeds=(0, 1), size=32, base_filters=2, steps=2, batch_size=1,
        validate_every=1, minutes_per_checkpoint=0.0,
    )  # fmt: skip
    return _command(reproduce_fig5, options)


def objectnav_train_(
    dataset: str, folder: Path, patch: pytest.MonkeyPatch, encoder: Path | None = None
) -> Command:  # fmt: skip
    patch.setattr(objectnav_train, "indoor_houses", lambda *args, **options: [two_rooms()])
    patch.setattr(objectnav_train, "random_views", lambda *args: None)
    patch.setattr(objectnav_train, "EncoderArchitecture", lambda: SMALL_ENCODER)
    patch.setattr(objectnav_train, "encoder_task", fake_encoder_task)
    patch.setattr(objectnav_train, "collect", lambda *args: trainings.journeys())
    _steps(patch)
    patch.setattr(objectnav_train, "validation_samples", lambda *args: None)
    patch.setattr(objectnav_train, "figures", lambda *args: {"error": 0.5})
    options = objectnav_train.Options(
        out=folder, count=1, validation_houses=1, encoder=encoder, encoder_steps=2, widths=(2, 2), steps=1,
        batch_size=1, collection=CollectionConfig(journeys=1, views=4, places=1), validate_every=1,
        minutes_per_checkpoint=0.0,
    )  # fmt: skip
    return _command(objectnav_train, options)


def objectnav_train_with_encoder_(dataset: str, folder: Path, patch: pytest.MonkeyPatch) -> Command:
    weights = fresh_weights(SmallEncoder, SMALL_ENCODER, jax.random.key(0))
    write_network(folder / "given", weights, SMALL_ENCODER, ENCODER)
    return objectnav_train_(dataset, folder, patch, folder / "given")


#: `(houses, folder for inputs, patch) -> command`, by the name of its module.
COMMANDS: dict[str, Callable[[str, Path, pytest.MonkeyPatch], Command]] = {
    each.__name__.rstrip("_"): each
    for each in (
        run_episodes_, reproduce_fig7_, compare_, head_to_head_, unknown_dimensions_, noisy_mapping_, objectnav_table1_,
        objectnav_table2_, train_, sweep_, reproduce_fig5_, objectnav_train_,
        objectnav_train_with_encoder_,
    )
}  # fmt: skip
