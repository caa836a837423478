"""Check a map of your own before planning on it: `dc2g map check my.png --palette palette.csv`."""

import dataclasses

import numpy as np

from dc2g_jax._src.cli.map_options import MapOptions, doubts_about, terrain_of
from dc2g_jax._src.cli.options import OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.figures.map_figures import plot_map
from dc2g_jax._src.files.class_images import read_palette
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.map_report import map_report, map_warnings
from dc2g_jax._src.readers.maps import require_path_to_goal


@dataclasses.dataclass(frozen=True)
class Options(MapOptions, OutOptions):
    """Show what a planner would see of a map: classes, ground, goals and cost-to-go, as text and as a figure."""


def main(options: Options) -> None:
    """Read, report and draw the map. A map without a path to a goal is drawn too, then rejected."""
    terrain = terrain_of(options)
    out = output_folder(options, "check_map")
    cost_to_go = np.asarray(world_cost_to_go(World.from_terrain(terrain)))
    lines = map_report(terrain, cost_to_go)
    lines += [f"warning: {line}" for line in map_warnings(terrain) + doubts_about(options)]
    title = f"{options.map.name}: {terrain.shape[1]} x {terrain.shape[0]} cells"
    print("\n".join([title, *lines]))
    palette = None if options.palette is None else read_palette(options.palette)
    plot_map(out / options.map.stem, title, terrain, cost_to_go, palette)
    print_files(out)
    require_path_to_goal(str(options.map), terrain)
