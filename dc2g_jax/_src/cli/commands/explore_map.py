"""Run planners on a map of your own: `dc2g map explore my.png --palette palette.csv`."""

import dataclasses

from dc2g_jax._src.cli.map_options import MapOptions, doubts_about, pixels_of, start_in, terrain_of
from dc2g_jax._src.cli.one_start import OneStartOptions, run_one_start
from dc2g_jax._src.cli.options import StepLimitOptions
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.map_report import unlike_training


@dataclasses.dataclass(frozen=True)
class Options(MapOptions, OneStartOptions, StepLimitOptions):
    """Run planners from one start on your own map: writes a table, a figure, an animation and a rerun recording."""


def main(options: Options) -> None:
    """Read the map, run the planners, write their files."""
    terrain = terrain_of(options)
    house = House(options.map.stem, "test", terrain)
    start = start_in(str(options.map), house, options.start, options.seed)
    doubts = doubts_about(options)
    run_one_start(options, "explore_map", "episode", house, start, step_limit=options.step_limit, warnings=doubts)
    another = "" if options.start else ": --seed gives another"
    print(f"One start says little{another}; dc2g compare --family FOLDER runs many.")
    if options.network is None:
        for line in unlike_training(terrain, pixels_of(options)):
            print(f"Unlike the training: {line}")
