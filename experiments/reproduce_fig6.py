"""The paper's Fig. 6: cost-to-go images of whole test maps, against each map's distance from the training houses.

`python -m experiments.reproduce_fig6 --network outputs/fig5/runs/l1+gan-seed0/network checkpoints/mine/network`
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.tables import text_table, write_table
from dc2g_jax._src.readers.houses import House, group_of, open_dataset
from experiments.support.commands import number_or_null
from experiments.translator.evaluation import distances_from_training, full_map_metrics
from experiments.translator.figures import METRIC_LABELS, plot_by_similarity
from experiments.translator.metrics import HouseMetrics
from experiments.translator.pairs import GRID_CELLS, houses_with_door


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, OutOptions):
    """Reproduce Fig. 6: five metrics of each network on every test house, against its distance from training houses.

    Attributes:
      network: folders of trained networks, of either kind, or hf://owner/name; the shipped one by default.
    """

    network: Annotated[tuple[str | Path, ...], tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = ()


def print_table(networks: dict[str, dict[str, dict[str, float]]]) -> None:
    """Print the summaries of all metrics, a block for each network."""
    for network, summaries in networks.items():
        rows = ((name, *(f"{value:.3f}" for value in summary.values())) for name, summary in summaries.items())
        print(f"\n{network}\n{text_table(('', *next(iter(summaries.values()))), rows)}")


def write_houses(path: Path, houses: Sequence[House], networks: dict[str, HouseMetrics]) -> None:
    """Write `houses.csv`: one row per network and house."""
    rows = []
    for network, points in networks.items():
        for number, house in enumerate(houses):
            values = (points.distance[number], *(points.metrics[name][number] for name in METRIC_LABELS))
            cells = (round(value, 5) if np.isfinite(value) else "" for value in values)
            rows.append((network, house.name, group_of(house), *cells))
    write_table(path, ("network", "house", "group", "distance", *METRIC_LABELS), rows)


def main(options: Options) -> None:
    """Compute the metrics; print, write and plot them."""
    dataset = open_dataset(options.dataset, cells=None)
    houses = houses_with_door(dataset, "test")
    chosen = {str(place): load_network(place) for place in options.network} or {"shipped": load_network()}
    out = output_folder(options, "reproduce_fig6")
    distance = distances_from_training(dataset, houses)
    images = [house.terrain for house in houses]
    networks = {name: HouseMetrics.of(distance, full_map_metrics(network, images)) for name, network in chosen.items()}
    summaries = {
        network: {name: points.summary(name) for name in METRIC_LABELS} for network, points in networks.items()
    }
    print_table(summaries)
    write_houses(out / "houses.csv", houses, networks)
    caption = (
        f"{len(houses)} test houses of {dataset.name}, fully observed. A network that gives a cost for every cell\n"
        f"takes traversability from the map, and is compared on the {GRID_CELLS} x {GRID_CELLS} grid of robots, a "
        "translator on its own picture.\nWhere nothing is predicted to be near a goal there is no precision."
    )
    plot_by_similarity(out / "fig6", networks, caption)
    facts = {
        "dataset": dataset.name,
        "houses": len(houses),
        "networks": {
            network: {
                name: {column: number_or_null(value) for column, value in summary.items()}
                for name, summary in found.items()
            }
            for network, found in summaries.items()
        },
    }
    write_json(out / "results.json", facts)
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
