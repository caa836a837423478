"""Compare the inputs of the network, as in Table II of the paper on dense cost maps.

`python -m experiments.objectnav_table2`: each network predicts costs for the same partial maps of unseen houses, and
guides the same searches.
"""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro

from dc2g_jax.cli.common import command_line, digests
from dc2g_jax.cli.outputs import output_folder
from dc2g_jax.cli.searches import ON_NETWORK, ComparisonOptions, agent_with, conclude, open_costs, run_searches
from dc2g_jax.errors import InputError
from dc2g_jax.objectnav.collecting import CollectionConfig, collect
from dc2g_jax.objectnav.evaluation import SearchResult, SearchSummary, summarize
from dc2g_jax.objectnav.houses import IndoorHouse
from dc2g_jax.objectnav.metrics import OF_CLASSES
from dc2g_jax.objectnav.networks import ABLATIONS, CostMapEstimator
from dc2g_jax.objectnav.predicted_costs import PredictedCosts
from dc2g_jax.objectnav.training import CostMapConfig, figures, validation_samples
from dc2g_jax.rollouts.results import ResumableTable

#: Titles of the rows, by name of the ablation.
ABLATION_TITLES = {"both": "both", "semantic": "only semantic map", "midlevel": "only mid-level"}

#: Metrics of the prediction, in percent.
METRICS = ("MPA", "mF1", "mIoU", "aAP5", "aAP9")

#: Of these, the paper gives F1 and IoU of each class for its own network alone, in percent (section IV-A).
PAPER_OF_CLASSES = (71.08, 80.68, 56.79, 69.06)

#: Partial maps per prediction.
MAPS_A_BATCH = CostMapConfig.batch_size


class Table2Line(NamedTuple):
    """A row of Table II of the paper: `METRICS` in percent, success, SPL and distance to success in meters."""

    metrics: tuple[float, float, float, float, float]
    success: float
    spl: float
    distance: float


#: Table II of the paper, on its houses.
PAPER_TABLE2 = {
    "semantic": Table2Line((79.17, 76.32, 63.34, 36.49, 32.47), 0.377, 0.290, 4.803),
    "midlevel": Table2Line((79.11, 76.32, 63.47, 37.21, 33.11), 0.402, 0.287, 4.716),
    "both": Table2Line((78.76, 75.89, 62.93, 37.45, 33.39), 0.447, 0.329, 4.542),
}


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions):
    """Compare networks with semantic maps, mid-level features or both as inputs, in unseen houses.

    Attributes:
      networks: folders of networks, from experiments.objectnav_train with `--inputs semantic` and so on; the last one
        is compared with the others. The shipped network by default.
      agent: how costs guide the robot: promising or predicted; see experiments.objectnav_table1.
      maps: number of partial maps to predict costs for.
    """

    networks: Annotated[tuple[str | Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = ()
    agent: Annotated[str, tyro.conf.arg(metavar="NAME")] = "promising"
    maps: int = 2048


def ablation(estimator: CostMapEstimator) -> str:
    """The name of a network's inputs."""
    return next(name for name, inputs in ABLATIONS.items() if inputs == estimator.architecture.inputs)


def open_networks(places: tuple[str | Path, ...]) -> dict[str, PredictedCosts[CostMapEstimator]]:
    """The networks by name of their inputs.

    Raises:
      InputError: two networks have the same inputs.
    """
    found: dict[str, PredictedCosts[CostMapEstimator]] = {}
    for place in places or (None,):
        costs = open_costs(place)
        name = ablation(costs.estimator)
        if name in found:
            raise InputError(
                f"--networks {place}: another one has these inputs ({ABLATION_TITLES[name]}); give one of each"
            )
        found[name] = costs
    return found


def prediction_metrics(
    costs: PredictedCosts[CostMapEstimator], houses: list[IndoorHouse], options: Options
) -> dict[str, float]:
    """`METRICS` and `OF_CLASSES`, in percent, on partial maps collected by robots in the houses."""
    largest = max(max(house.world.free.shape) for house in houses)
    samples = collect(houses, costs.encoder, CollectionConfig(largest=largest, data_seed=options.seed))
    config = CostMapConfig(costs.estimator.architecture)
    found = figures(costs.estimator, validation_samples(samples, config, options.maps), config)
    return {name: found[name] for name in (*METRICS, *OF_CLASSES)}


def table(metrics: dict[str, dict[str, float]], summaries: dict[str, SearchSummary]) -> str:
    """Table II as text, with the paper's row below each of ours."""
    lines = [_line("", ("MPA %", "mF1 %", "mIoU %", "aAP5 %", "aAP9 %", "success", "SPL", "DTS m"))]
    for name, one in summaries.items():
        values = (*(metrics[name][metric] for metric in METRICS), one.success, one.spl, one.distance)
        paper = PAPER_TABLE2[name]
        lines.append(_line(ABLATION_TITLES[name], _figures(*values)))
        lines.append(_line("the paper's", _figures(*paper.metrics, paper.success, paper.spl, paper.distance)))
    return "\n".join(lines)


def table_of_classes(metrics: dict[str, dict[str, float]]) -> str:
    """F1 and IoU of free and of occupied cells as text."""
    rows = {ABLATION_TITLES[name]: [found[score] for score in OF_CLASSES] for name, found in metrics.items()}
    rows["the paper's (both)"] = list(PAPER_OF_CLASSES)
    lines = [_line("", [f"{score} %" for score in OF_CLASSES], width=14)]
    lines += [_line(title, [f"{value:.2f}" for value in values], width=14) for title, values in rows.items()]
    return "\n".join(lines)


def _figures(*values: float) -> tuple[str, ...]:
    return (*(f"{value:.2f}" for value in values[:5]), *(f"{value:.3f}" for value in values[5:7]), f"{values[7]:.2f}")


def _line(title: str, cells: Sequence[str], width: int = 7) -> str:
    return "  ".join([f"{title:>18}", *(f"{cell:>{width}}" for cell in cells)])


def main(options: Options) -> None:
    """Predict and search; print and write the table."""
    options.check()
    if options.agent not in ON_NETWORK:
        raise InputError(f"--agent {options.agent}: give {' or '.join(ON_NETWORK)}, which use a network")
    if options.maps < MAPS_A_BATCH or options.maps % MAPS_A_BATCH:
        raise InputError(f"--maps {options.maps}: give a multiple of {MAPS_A_BATCH}")
    networks = open_networks(options.networks)
    houses, episodes = options.places()
    inputs = digests(houses=[house.world for house in houses], networks=networks)
    out = output_folder(options, "objectnav_table2", inputs=inputs)
    searches, results = ResumableTable(out / "episodes.csv", SearchResult), dict[str, list[SearchResult]]()
    metrics = {}
    for name, costs in networks.items():
        metrics[name] = prediction_metrics(costs, houses, options)
        agent = functools.partial(agent_with, options.agent, costs, options.samples)
        results[name] = run_searches(searches, name, agent, houses, episodes, options)
    summaries = {name: summarize(found, resamples=options.resamples) for name, found in results.items()}
    facts = {
        "prediction": metrics,
        "navigation": {name: one._asdict() for name, one in summaries.items()},
        "paper": {name: one._asdict() for name, one in PAPER_TABLE2.items()},
    }
    text = f"{options.maps} maps, {len(episodes)} searches in {options.described}\n{table(metrics, summaries)}"
    text += f"\n\n{table_of_classes(metrics)}"
    conclude(out, options, houses, results, ABLATION_TITLES, text, facts)


if __name__ == "__main__":
    command_line(Options, main)
