"""Compare the inputs of the network, as in Table II of the paper on dense cost maps.

`python -m experiments.objectnav_table2`: each network predicts costs for the same partial maps of unseen houses, and
guides the same searches.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import tyro

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.errors import InputError
from dc2g_jax.indoor.houses.dataset import IndoorHouse
from dc2g_jax.indoor.learning.collecting import CollectionConfig, collect
from dc2g_jax.indoor.learning.losses import OF_CLASSES
from dc2g_jax.indoor.learning.networks import CostMapEstimator, load_costs
from dc2g_jax.indoor.learning.training import CostMapConfig, figures, validation_samples
from dc2g_jax.indoor.search.evaluation import (
    ABLATION_TITLES,
    METRICS,
    PAPER_TABLE2,
    SearchSummary,
    table2,
)
from dc2g_jax.indoor.search.guides import ON_NETWORK, agent_with
from experiments.support.searches import ComparisonOptions, compare

#: Partial maps per prediction.
_MAPS_A_BATCH = CostMapConfig.batch_size


@dataclasses.dataclass(frozen=True)
class Options(ComparisonOptions):
    """Compare networks with semantic maps, mid-level features or both as inputs, in unseen houses.

    Attributes:
      networks: folders of networks, from `dc2g train-indoor` with `--inputs semantic` and so on; the last one
        is compared with the others. The shipped network by default.
      agent: how costs guide the robot: promising or predicted; see python -m experiments.objectnav_table1.
      maps: number of partial maps to predict costs for.
    """

    networks: Annotated[tuple[str | Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = ()
    agent: Annotated[str, tyro.conf.arg(metavar="NAME")] = "promising"
    maps: int = 2048


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
    if options.agent not in ON_NETWORK:
        raise InputError(f"--agent {options.agent}: give {' or '.join(ON_NETWORK)}, which use a network")
    if options.maps < _MAPS_A_BATCH or options.maps % _MAPS_A_BATCH:
        raise InputError(f"--maps {options.maps}: give a multiple of {_MAPS_A_BATCH}")
    networks = open_networks(options.networks)
    agents = {
        name: agent_with(options.agent, network, options.samples, options.noise) for name, network in networks.items()
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
