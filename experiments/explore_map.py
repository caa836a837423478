"""Send the planners over a map of your own: `python -m experiments.explore_map my.png --palette palette.csv`."""

import dataclasses
import sys

from dc2g_jax.cli.common import NetworkOption, OutOption, PlannersOption, StepLimitOption, command_line
from dc2g_jax.cli.episodes import EpisodeTable
from dc2g_jax.cli.map_options import MapOptions, StartOption, doubts_about, start_in, terrain_of
from dc2g_jax.cli.one_start import Animation, draw_request, make_request, require_sensing_range, run_request, tell_files
from dc2g_jax.cli.outputs import output_folder
from dc2g_jax.datasets.houses import House
from dc2g_jax.datasets.maps import require_path_to_goal


@dataclasses.dataclass(frozen=True)
class Options(MapOptions):
    """Run planners from one start on a map of your own: a table, a figure, an animation and a recording of each step.

    Attributes:
      start: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up); sampled where not given, on
        the road where there is one.
      seed: of the sampled start.
      planner: planners to run, besides the oracle; figures show them in this order. One of your own as
        package.module:Class.
      sensing_range: how many cells ahead a robot sees.
      network: folder of a trained network for `dc2g` and `dc2g_uncertain`; the shipped one where not given.
      step_limit: actions after which an episode ends without success; where not given, 500, and on
        maps of over 50 x 50 cells one action for every five cells of the map.
      animation: formats of the animation.
      out: folder to write to; a new one below outputs/ where not given.
    """

    start: StartOption = None
    seed: int = 0
    planner: PlannersOption = ("dc2g", "frontier")
    sensing_range: int = 8
    network: NetworkOption = None
    step_limit: StepLimitOption = None
    animation: tuple[Animation, ...] = ("gif",)
    out: OutOption = None


def main(options: Options) -> None:
    """Read, run, draw."""
    sensing_range = require_sensing_range(options.sensing_range)
    terrain = terrain_of(options)
    require_path_to_goal(str(options.map), terrain)
    house = House(options.map.stem, "test", terrain)
    start = start_in(str(options.map), house, options.start, options.seed)._replace(sensing_range=sensing_range)
    request = make_request(house, start, options.planner, options.network, options.step_limit)
    out = output_folder(options, "explore_map")
    for doubt in doubts_about(options):
        print(f"warning: {doubt}", file=sys.stderr)
    results = run_request(request, EpisodeTable(out / "episodes.csv"))
    draw_request(out, "episode", request, results, options.animation)
    tell_files(out)
    print("One start says little: --seed gives another; dc2g fig7 --settings paper --dataset FOLDER runs many.")
    if options.network is None:
        print("The shipped network knows suburban houses on 50 x 50 cells: elsewhere, frontier may be shorter.")


if __name__ == "__main__":
    command_line(Options, main)
