"""Compare the inputs of the network, as in Table II of the paper on dense cost maps.

`python -m experiments.objectnav_table2`: each network predicts costs for the same partial maps of unseen houses, and
guides the same searches.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.runtime.errors import InputError, check_name
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.learning.networks import CostMapEstimator, load_costs
from dc2g_jax.indoor.search.guides import ON_NETWORK, agent_with
from experiments.objectnav.collecting import CollectionConfig, collect
from experiments.objectnav.losses import OF_CLASSES
from experiments.objectnav.training import CostMapConfig, figures, validation_samples
from experiments.support.searches import ComparisonOptions, SearchSummary, compare

#: Titles of the inputs of a network, see `indoor.learning.networks.Inputs`.
ABLATION_TITLES = {"both": "both", "semantic": "only semantic map", "midlevel": "only mid-level"}

#: Metrics of the prediction in Table II, in percent.
METRICS = ("MPA", "mF1", "mIoU", "aAP5", "aAP9")

#: Table II of the paper: `METRICS` in percent, success, SPL and distance to success in meters.
PAPER_TABLE2: dict[str, dict[str, Any]] = {
    name: dict(zip(("metrics", "success", "spl", "distance"), line, strict=True))
    for name, line in {
        "semantic": ((79.17, 76.32, 63.34, 36.49, 32.47), 0.377, 0.290, 4.803),
        "midlevel": ((79.11, 76.32, 63.47, 37.21, 33.11), 0.402, 0.287, 4.716),
        "both": ((78.76, 75.89, 62.93, 37.45, 33.39), 0.447, 0.329, 4.542),
    }.items()
}

#: Of these, the paper gives F1 and IoU of each class for its own network alone, in percent (section IV-A).
_PAPER_OF_CLASSES = (71.08, 80.68, 56.79, 69.06)

#: Partial maps per prediction.
_MAPS_A_BATCH = CostMapConfig.batch_size


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions):
    """Compare networks with semantic maps, mid-level features or both as inputs, in unseen houses.

    Attributes:
      networks: folders of networks, from `objectnav_train` with `--inputs semantic` and so on; the last one
        is compared with the others. The shipped network by default.
      agent: how costs guide the robot: predicted (the paper's) or promising; see python -m
        experiments.objectnav_table1.
      maps: number of partial maps to predict costs for.
    """

    networks: Annotated[tuple[str | Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = ()
    agent: Annotated[str, tyro.conf.arg(metavar="NAME")] = "predicted"
    maps: int = 2048


def table2(metrics: Mapping[str, Mapping[str, float]], summaries: Mapping[str, SearchSummary]) -> str:
    """Table II, with the paper's row below each of ours, and then F1 and IoU of free and of occupied cells.

    Args:
      metrics: `METRICS` and `OF_CLASSES` of each network, given by the name of its inputs, in percent.
      summaries: the searches that each network led.
    """
    rows = [["", *(f"{name} %" for name in METRICS), "success", "SPL", "DTS m"]]
    of_classes = [["", *(f"{score} %" for score in OF_CLASSES)]]
    for name, one in summaries.items():
        ours = [metrics[name][metric] for metric in METRICS], one.success.mean, one.spl.mean, one.distance
        for title, line in ((ABLATION_TITLES[name], ours), ("the paper's", PAPER_TABLE2[name].values())):
            percent, success, spl, distance = line
            rows.append([title, *map("{:.2f}".format, percent), f"{success:.3f}", f"{spl:.3f}", f"{distance:.2f}"])
        of_classes.append([ABLATION_TITLES[name], *(f"{metrics[name][score]:.2f}" for score in OF_CLASSES)])
    of_classes.append(["the paper's (both)", *map("{:.2f}".format, _PAPER_OF_CLASSES)])
    return "\n\n".join(text_table(columns, lines) for columns, *lines in (rows, of_classes))


def open_networks(places: tuple[str | Path, ...]) -> dict[str, CostMapEstimator]:
    """The networks by name of their inputs.

    Raises:
      InputError: two networks have the same inputs.
    """
    found: dict[str, CostMapEstimator] = {}
    for place in places or (None,):
        network = load_costs(place)
        name = network.architecture.inputs
        if name in found:
            raise InputError(
                f"--networks {place}: another one has these inputs ({ABLATION_TITLES[name]}); give one of each"
            )
        found[name] = network
    return found


def prediction_metrics(network: CostMapEstimator, houses: list[IndoorHouse], options: Options) -> dict[str, float]:
    """`METRICS` and `OF_CLASSES`, in percent, on partial maps collected by robots in the houses."""
    largest = max(max(house.world.free.shape) for house in houses)
    samples = collect(houses, network.encoder, CollectionConfig(largest=largest, data_seed=options.seed))
    config = CostMapConfig(network.architecture)
    found = figures(network.weights, validation_samples(samples, config, options.maps), config)
    return {name: found[name] for name in (*METRICS, *OF_CLASSES)}


def main(options: Options) -> None:
    """Search and predict; print and write the table."""
    check_name("agent on a network", options.agent, ON_NETWORK)
    if options.maps < _MAPS_A_BATCH or options.maps % _MAPS_A_BATCH:
        raise InputError(f"--maps {options.maps}: give a multiple of {_MAPS_A_BATCH}")
    networks = open_networks(options.networks)
    agents = {
        name: agent_with(options.agent, network, samples=options.samples, noise=options.noise)
        for name, network in networks.items()
    }

    def report(houses: list[IndoorHouse], summaries: dict[str, SearchSummary]) -> tuple[str, dict[str, Any]]:
        metrics = {name: prediction_metrics(network, houses, options) for name, network in networks.items()}
        facts = {
            "prediction": metrics,
            "navigation": {name: one._asdict() for name, one in summaries.items()},
            "paper": PAPER_TABLE2,
        }
        return f"Predictions on {options.maps} maps.\n{table2(metrics, summaries)}", facts

    compare("objectnav_table2", options, agents, ABLATION_TITLES, report, networks=networks)


if __name__ == "__main__":
    command_line(Options, main)
