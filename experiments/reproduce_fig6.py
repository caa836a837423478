"""The paper's Fig. 6: cost-to-go images of whole test maps, against each map's distance from the training houses.

`python -m experiments.reproduce_fig6 --network checkpoints/translator/network checkpoints/mine/network`
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dc2g_jax.cli.common import command_line
from dc2g_jax.cli.options import DatasetOptions, OutOptions
from dc2g_jax.cli.outputs import number_or_null, output_folder, print_files
from dc2g_jax.datasets.houses import House, HouseDataset, group_of, open_dataset
from dc2g_jax.datasets.similarity import distance_to_training, similarity_scale
from dc2g_jax.estimation.hub import load
from dc2g_jax.files.atomic import write_json
from dc2g_jax.files.tables import write_table
from dc2g_jax.grid.sampling import resize_nearest
from dc2g_jax.inspection.image_figures import METRIC_LABELS, HouseMetrics, plot_by_similarity
from dc2g_jax.training.image_evaluation import GRID_CELLS, full_map_metrics
from dc2g_jax.training.image_pairs import houses_with_door

#: Side length, in pixels, of the maps for the comparison with training maps.
_SIZE = 256


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, OutOptions):
    """Reproduce Fig. 6: five metrics of each network on every test house, against its distance from training houses.

    Attributes:
      network: folders of trained networks, of either kind, or hf://owner/name; the shipped one by default.
    """

    network: tuple[str | Path, ...] = ()


def distances(dataset: HouseDataset, houses: Sequence[House]) -> list[float]:
    """Distance of each house from the training houses."""

    def squeezed(house: House) -> np.ndarray:
        return resize_nearest(house.terrain, _SIZE, _SIZE)

    scale = similarity_scale(np.stack([squeezed(house) for house in houses_with_door(dataset, "train")]))
    return [distance_to_training(squeezed(house), scale) for house in houses]


def points_of(distance: Sequence[float], rows: Sequence[dict[str, float]]) -> HouseMetrics:
    """A network's metrics by name, with a least-squares line for each.

    There is no line if all houses have the same distance. Houses without a value are ignored.
    """
    metrics = {name: [row[name] for row in rows] for name in METRIC_LABELS}
    fits = {}
    for name, values in metrics.items():
        known = np.isfinite(values)
        apart = np.asarray(distance)[known]
        if apart.size and np.ptp(apart) > 0:
            slope, intercept = np.polyfit(apart, np.asarray(values)[known], 1)
            fits[name] = (float(slope), float(intercept))
    return HouseMetrics(distance, metrics, fits)


def summary_of(points: HouseMetrics, name: str) -> dict[str, float]:
    """Mean, lowest and highest value of a metric over the houses with a value; slope and intercept of its line.

    NaN where there is none.
    """
    known = [value for value in points.metrics[name] if np.isfinite(value)] or [math.nan]
    slope, intercept = points.fits.get(name, (math.nan, math.nan))
    return {
        "mean": float(np.mean(known)),
        "lowest": min(known),
        "highest": max(known),
        "slope": slope,
        "intercept": intercept,
    }


def print_table(networks: dict[str, dict[str, dict[str, float]]]) -> None:
    """Print the summaries of all metrics, a block for each network."""
    for network, summaries in networks.items():
        print(f"\n{network}\n{'':24}" + "".join(f"{column:>11}" for column in next(iter(summaries.values()))))
        for name, summary in summaries.items():
            print(f"{name:24}" + "".join(f"{value:>11.3f}" for value in summary.values()))


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
    chosen = {str(place): load(place) for place in options.network} or {"shipped": load()}
    out = output_folder(options, "reproduce_fig6")
    distance = distances(dataset, houses)
    images = [house.terrain for house in houses]
    networks = {name: points_of(distance, full_map_metrics(network, images)) for name, network in chosen.items()}
    summaries = {
        network: {name: summary_of(points, name) for name in METRIC_LABELS} for network, points in networks.items()
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
