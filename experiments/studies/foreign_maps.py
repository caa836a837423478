"""Planners on maps from other collections: `python -m experiments.studies.foreign_maps --maps FILE.npz`.

The file holds maps without classes, as arrays: `names` (collection/map) and `free` (one bit per cell).
"""

import dataclasses
import zipfile
from pathlib import Path

import numpy as np

from dc2g_jax._src.cli.common import PlannersOption, check_planners, command_line
from dc2g_jax._src.cli.episodes import EpisodeTable, NetworksOptions
from dc2g_jax._src.cli.options import OutOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.files.reading import check_file
from dc2g_jax._src.planning.rules import named_settings
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.leaderboard import families_of, in_order, mean_ratio
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax.families import with_door


@dataclasses.dataclass(frozen=True)
class Options(NetworksOptions, OutOptions):
    """Steps of planners relative to frontier exploration, by collection, from random starts to random doors.

    Attributes:
      maps: the file.
      planner: planners to compare; frontier is added.
      starts: starts in each map, each with its own door.
      seed: seed of doors and starts.
    """

    maps: Path
    planner: PlannersOption = ("dc2g", "next_best_view")
    starts: int = 2
    seed: int = 0


def foreign_dataset(path: Path, starts: int, seed: int) -> HouseDataset:
    """The maps, each `starts` times, with random doors.

    Raises:
      InputError: the file cannot be read or holds no such maps.
    """
    hint = "give --maps an .npz file with the arrays names and free"
    check_file(path, hint)
    try:
        with np.load(path) as file:
            names, free = file["names"], np.unpackbits(file["free"], axis=-1).astype(bool)
        _, side, width = free.shape
        if names.shape != free.shape[:1] or not side <= width < side + 8:
            raise ValueError(
                f"names {names.shape}, free {free.shape}: the maps are not square, or not as many as names"
            )
    except (EOFError, ValueError, LookupError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: holds no maps ({error}); {hint}") from None
    houses = []
    for number, (name, cells) in enumerate(zip(names, free, strict=True)):
        for door in range(starts):
            terrain = with_door(cells[:, :side], np.random.default_rng([seed, number, door]))
            if terrain is not None:
                houses.append(House(f"{name}/{door}", "val", terrain))
    if not houses:
        raise InputError(f"{path}: no map has enough free cells; {hint}")
    return HouseDataset("foreign", "folder", tuple(houses))


def main(options: Options) -> None:
    """Run, and print a table."""
    require_positive(options, "starts")
    planners = ("frontier", *(name for name in options.planner if name != "frontier"))
    check_planners(planners)
    dataset = foreign_dataset(options.maps, options.starts, options.seed)
    out = output_folder(options, "foreign_maps")
    runner = Runner(dataset, named_settings("paper"), progress=EpisodeProgress())
    results = EpisodeTable(out / "episodes.csv").run(
        runner, sample_starts(dataset.houses, 1, seed=options.seed), planners, options.open(planners)
    )
    families = families_of(results, dict.fromkeys((house.name for house in dataset.houses), runner.step_limit))
    counts = {name: len({house.rpartition("/")[0] for house in family.maps}) for name, family in families.items()}
    heads = " | ".join(f"{name} ({count})" for name, count in counts.items())
    lines = [f"| planner | all | {heads} |", f"|---|{'---|' * (len(families) + 1)}"]
    for planner in in_order(families):
        own = " | ".join(f"{family.ratio(planner).mean:.2f}" for family in families.values())
        lines.append(f"| `{planner}` | {mean_ratio(families, planner):.2f} | {own} |")
    (out / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
