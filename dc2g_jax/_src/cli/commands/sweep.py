"""Train networks with many losses, weights, learning rates, widths and seeds: `dc2g sweep`.

Runs whose networks have the same shape are trained together and divided among the devices, `--runs-at-once` at a time.
After an interruption, --resume continues where it stopped.
"""

import dataclasses
import functools
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dc2g_jax._src.cli.common import digests
from dc2g_jax._src.cli.options import DataOptions, DatasetOptions, TrainingOptions
from dc2g_jax._src.cli.outputs import number_or_null, output_folder
from dc2g_jax._src.errors import InputError, short
from dc2g_jax._src.estimation.checkpoints import CARD, TrainingCheckpoints, network_in_folder, save_network
from dc2g_jax._src.estimation.compact_unet import Architecture, check_network, multiply_accumulates
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.figures.training_figures import plot_sweep
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.files.tables import write_table
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.rollouts.devices import fetch, mesh_for_batch, replicate, require_memory
from dc2g_jax._src.rollouts.progress import EpisodeProgress
from dc2g_jax._src.training import sweeps
from dc2g_jax._src.training.cost_to_go import (
    CostToGoTraining,
    TrainingConfig,
    first_state,
    learning_rates,
    least_memory,
)
from dc2g_jax._src.training.cost_to_go_data import Validation, check_houses, open_training_set, validation_pairs
from dc2g_jax._src.training.loop import Log, Losses, Pauses, Task, fit
from dc2g_jax._src.training.losses import losses_as_text
from dc2g_jax._src.training.pairs import Pair, TrainingSet
from dc2g_jax._src.training.step import TrainingState, placed, supervised_step
from dc2g_jax._src.training.tracking import Image, run_folder
from dc2g_jax._src.viewer.training_recording import prediction_picture

#: Number of validation pairs, and of those in pictures for a tracker.
_PAIRS, _PAIRS_SHOWN = 512, 6

#: Numbers in every line of the log.
_FIGURES = ("error", "steps_left_out")


@dataclasses.dataclass(frozen=True)
class Options(Pauses, DatasetOptions, TrainingOptions, DataOptions):
    """Train every combination of losses, learning rates, widths and seeds, together where shapes allow.

    Attributes:
      losses: losses to try: quantile, l1, l2, huber, log, package.module:Name for one of your own, or weighted sums of
        them such as quantile=1,log=0.5.
      architecture: compact_unet, or package.module:Name for a network of your own, a subclass of flax.nnx.Module.
      learning_rates: peak learning rates to try.
      widths: networks to try, each given by its channels from the finest scale: 24,48,96 16,32,64,128 are two.
      seeds: seeds to try.
      steps: optimizer steps of each run.
      batch_size: pairs per step of each run.
      validate_every: steps between validations on pairs; the last step is validated too. 0 for the last step only.
      no_episodes: do not run the planner in validation houses with every network at the end.
      runs_at_once: largest number of runs to train together; best a multiple of the number of devices. It may change
        when the sweep is resumed.
    """

    losses: tuple[str, ...] = ("quantile", "l1", "l2", "huber", "log")
    architecture: str = Architecture.network
    learning_rates: tuple[float, ...] = (TrainingConfig.learning_rate,)
    widths: tuple[str, ...] = (",".join(map(str, Architecture.widths)),)
    seeds: tuple[int, ...] = (0, 1, 2)
    steps: int = 2000
    batch_size: int = TrainingConfig.batch_size
    validate_every: int = 200
    no_episodes: bool = False
    runs_at_once: int = 64

    def runs(self, side: int) -> dict[str, TrainingConfig]:
        """The runs of the grid, by name, for training maps whose longer side has `side` cells.

        Raises:
          InputError: a value is invalid.
        """
        try:
            widths = [tuple(int(width) for width in text.split(",")) for text in self.widths]
        except ValueError:
            raise InputError(f"widths: {' '.join(self.widths)}; give whole numbers such as 24,48,96") from None
        return sweeps.runs_of_grid(
            TrainingConfig(
                Architecture(side=side, network=self.architecture), steps=self.steps, batch_size=self.batch_size
            ),
            losses=self.losses,
            learning_rates=self.learning_rates,
            widths=widths,
            seeds=self.seeds,
        )


def train_group(
    options: Options, runs: Mapping[str, TrainingConfig], data: TrainingSet, pairs: Pair, facts: dict[str, Any]
) -> None:
    """Train runs of one shape to the end and save their networks, unless they exist."""
    networks = [network_folder(options.out, run) for run in runs]
    if all((network / CARD).exists() for network in networks):
        return
    configs = list(runs.values())
    recipe, hyperparameters = configs[0].recipe, sweeps.stacked_hyperparameters(configs)
    training, log = CostToGoTraining(recipe, options.data.draw_batch), Log(options.out)
    mesh = mesh_for_batch(recipe.batch_size, len(runs))
    data = replicate(data, mesh)
    rates = np.stack([learning_rates(config) for config in configs], axis=1)

    def networks_of(states: TrainingState) -> list[NetworkCostToGo]:
        each = sweeps.fetched_runs(states.trained)
        return [NetworkCostToGo(weights=weights, architecture=recipe.architecture) for weights in each]

    def pictures(states: TrainingState) -> list[Image]:
        shown = jax.tree.map(lambda leaf: leaf[:_PAIRS_SHOWN], pairs)
        return [prediction_picture(network, shown) for network in networks_of(states)]

    def validate(states: TrainingState, step: int, losses: Losses | None) -> list[dict[str, Any]]:
        errors = np.asarray(sweeps.validation_errors(recipe.architecture, jax.tree.map(fetch, states.trained), pairs))
        left_out = fetch(sweeps.steps_left_out(states))
        return [
            {
                "run": run,
                "step": step,
                "loss": None if losses is None else number_or_null(float(losses[number])),
                "error": float(errors[number]),
                "steps_left_out": int(left_out[number]),
            }
            for number, run in enumerate(runs)
        ]

    task = Task(
        steps=recipe.steps,
        step=lambda states: supervised_step(states, data, hyperparameters, training=training, mesh=mesh),
        validate=validate,
        validated=set.intersection(*(set(log.by_step(run)) for run in runs)),
        name=f"{len(runs)} runs",
        runs=tuple(runs),
        learning_rate=lambda step: rates[step - 1],
        pictures=pictures,
        place=functools.partial(placed, mesh=mesh),
    )
    checkpoints = sweeps.StackedCheckpoints(
        [
            TrainingCheckpoints(network.parent, config, {**facts, "parts": config.parts}, first_state=first_state)
            for network, config in zip(networks, configs, strict=True)
        ]
    )
    states = fit(task, options.out, checkpoints, options, options.track)
    for folder, network, config in zip(networks, networks_of(states), configs, strict=True):
        save_network(folder, network, {"config": dataclasses.asdict(config), "facts": facts})


def network_folder(out: Path, run: str) -> Path:
    """The folder of a run's network."""
    return run_folder(out, run) / "network"


def kind_of(options: Options, config: TrainingConfig) -> str:
    """The parameters of a run that vary in the sweep, except the seed."""
    parts = [losses_as_text(config.losses)]
    if len(options.learning_rates) > 1:
        parts.append(f"rate {config.learning_rate!r}")
    if len(options.widths) > 1:
        parts.append(f"widths {'-'.join(map(str, config.architecture.widths))}")
    return ", ".join(parts)


def write_results(
    out: Path,
    runs: Mapping[str, TrainingConfig],
    log: Log,
    episodes: Mapping[str, Mapping[str, float]],
    shape: tuple[int, int],
) -> list[dict[str, Any]]:
    """Write `results.csv`, one row per run, the best first. Multiply-accumulates are for one map of `shape`."""
    architectures = {config.architecture for config in runs.values()}
    macs = {architecture: multiply_accumulates(architecture, *shape) for architecture in architectures}
    rows: list[dict[str, Any]] = []
    for run, config in runs.items():
        validations = log.by_step(run, _FIGURES)
        step = max(validations)
        rows.append(
            {
                "run": run,
                "loss": losses_as_text(config.losses),
                "learning_rate": config.learning_rate,
                "widths": "-".join(map(str, config.architecture.widths)),
                "million_multiply_accumulates": round(1e-6 * macs[config.architecture], 2),
                "seed": config.seed,
                "steps": step,
                "diverged": int(validations[step]["steps_left_out"] > 0),
                "error": round(validations[step]["error"], 4),
                **episodes.get(run, {}),
            }
        )
    rows.sort(key=lambda row: (row["diverged"], row.get("mean_extra", row["error"])))
    columns = list(rows[0])
    write_table(out / "results.csv", columns, ([row.get(column, "") for column in columns] for row in rows))
    return rows


def run_episodes(validation: Validation, runs: Collection[str], out: Path) -> dict[str, Any]:
    """Extra steps in validation houses with the network of each run. Results are saved in a file and reused."""
    path = out / "episodes.json"
    remedy = "delete it to run its episodes anew"
    found = read_object(path, remedy) if path.exists() else {}
    for number, run in enumerate(runs, start=1):
        if not isinstance(found.get(run, {}), dict):
            raise InputError(f"{path}: {run} has {short(found[run])}, no figures; {remedy}")
        if run not in found:
            print(f"episodes in validation houses: {run} ({number} of {len(runs)})", flush=True)
            found[run] = validation.figures(network_in_folder(network_folder(out, run)))
            write_json(path, found)
    return found


def main(options: Options) -> None:
    """Train and validate all runs; write and plot the results."""
    dataset = open_dataset(options.dataset)
    height, width = dataset.houses[0].terrain.shape
    options.check_pauses()
    runs = options.runs(max(height, width))  # raises before anything is written
    for config in runs.values():
        check_network(config.architecture)
    groups = sweeps.group_by_shape(runs)
    turns = [turn for group in groups for turn in sweeps.in_turns(group, options.runs_at_once)]
    check_houses(dataset, extra=options.data.extra_houses, drawn=not options.no_episodes, validated=True)
    largest = max(sum(least_memory(config, height, width) for config in turn.values()) for turn in turns)
    require_memory(largest, f"--batch-size {options.batch_size} or --runs-at-once {options.runs_at_once}")
    output_folder(options, "sweep", free=("minutes_per_checkpoint", "runs_at_once"), inputs=digests(dataset))
    facts = {"data": dataclasses.asdict(options.data), "dataset": dataset.name}
    # These raise for unsuitable houses before minutes of data collection.
    pairs = validation_pairs(dataset, count=_PAIRS, edge_weight=options.data.edge_weight)
    progress = EpisodeProgress(leave=False)
    validation = None if options.no_episodes else Validation(dataset, drawn=16, progress=progress)
    data = open_training_set(options.out, dataset, options.data)
    log = Log(options.out)
    print(f"runs: {len(runs)}; shapes of networks: {len(groups)}; turns: {len(turns)}")
    for turn in turns:
        train_group(options, turn, data, pairs, facts)
    episodes = run_episodes(validation, runs, options.out) if validation else {}
    rows = write_results(options.out, runs, log, episodes, (height, width))
    errors: dict[str, list[dict[int, float]]] = {}
    extra: dict[str, list[float]] = {}
    for run, config in runs.items():
        kind = kind_of(options, config)
        errors.setdefault(kind, []).append({step: line["error"] for step, line in log.by_step(run, _FIGURES).items()})
        if run in episodes:
            extra.setdefault(kind, []).append(episodes[run]["mean_extra"])
    plot_sweep(options.out / "sweep", errors, extra, f"{dataset.name}; errors on {_PAIRS} validation pairs")
    for row in rows:
        steps = f"   extra steps {row['mean_extra']:.1f} %" if "mean_extra" in row else ""
        warning = "   diverged: the loss of some steps was not finite" if row["diverged"] else ""
        print(f"{row['run']:60} error {row['error']:.2f} cells{steps}{warning}")
    print(f"Written to {options.out / 'results.csv'}")
