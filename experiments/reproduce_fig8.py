"""The paper's Fig. 8: planners side by side from one start in a house they have not seen.

`python -m experiments.reproduce_fig8` draws what each had observed, the cost-to-go it expected, and the way it took.
"""

import dataclasses
from typing import Annotated

import tyro

from dc2g_jax.cli.common import DatasetOption, NetworkOption, OutOption, PlannersOption, command_line
from dc2g_jax.cli.episodes import EpisodeProgress, EpisodeTable
from dc2g_jax.cli.map_options import StartOption, start_in
from dc2g_jax.cli.one_start import Animation, draw_request, make_request, require_sensing_range, run_request, tell_files
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.houses import HouseDataset, open_dataset
from dc2g_jax.datasets.starts import Start, sample_starts
from dc2g_jax.errors import InputError
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import Runner


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Reproduce Fig. 8: what planners observed and expected on their way from one start, and the way on the whole map.

    The paper does not name its house, and its episode (98 and 304 steps) is none of the 400 published ones. Where no
    house is named, one start is sampled in every test house, and the one is taken from which the oracle needs the
    median number of steps: neither the shortest nor the longest way, and chosen before any other planner is run.

    Attributes:
      house: name of the house; chosen as above where not given.
      start: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up) in that house; sampled where
        not given.
      seed: of the sampled starts.
      planner: planners to show, in this order; one of your own as package.module:Class.
      sensing_range: how many cells ahead a robot sees.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      network: folder of a trained network for `dc2g` and `dc2g_uncertain`; the shipped one where not given.
      animation: formats of the animation.
      out: folder to write to; a new one below outputs/ where not given.
    """

    house: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    start: StartOption = None
    seed: int = 0
    planner: PlannersOption = ("dc2g", "frontier")
    sensing_range: int = 8
    dataset: DatasetOption = None
    network: NetworkOption = None
    animation: tuple[Animation, ...] = ("gif",)
    out: OutOption = None


def median_start(dataset: HouseDataset, seed: int) -> Start:
    """Of one sampled start in each test house, that of the median number of oracle steps; the lower of two.

    Raises:
      InputError: if no episode can be run in any of them.
    """
    starts = sample_starts(dataset.split("test"), 1, seed=seed)
    if not starts:
        raise InputError(f"{dataset.name}: no episode can be run in any of its test houses; name another --house")
    results = Runner(dataset, SETTINGS["paper"], progress=EpisodeProgress()).run(starts, ("oracle",))
    order = sorted(range(len(starts)), key=lambda number: (results[number].steps, starts[number].house))
    return starts[order[(len(order) - 1) // 2]]


def main(options: Options) -> None:
    """Choose, run, draw."""
    sensing_range = require_sensing_range(options.sensing_range)
    dataset = open_dataset(options.dataset)
    if options.house is None and options.start is not None:
        raise InputError("--start: in which house? give --house as well")
    if options.house is None:
        start = median_start(dataset, options.seed)
    else:
        start = start_in(options.house, dataset.house(options.house), options.start, options.seed)
    start = start._replace(sensing_range=sensing_range)
    request = make_request(dataset.house(start.house), start, options.planner, options.network)
    out = output_folder(options, "reproduce_fig8")
    results = run_request(request, EpisodeTable(out / "episodes.csv"))
    draw_request(out, "fig8", request, results, options.animation)
    tell_files(out)


if __name__ == "__main__":
    command_line(Options, main)
