"""Compare planners in families of maps: `dc2g compare`."""

import dataclasses
import itertools
import time
from collections import Counter
from typing import Annotated, Literal

import tyro

from dc2g_jax._src.cli.common import PlannersOption, SettingsOption, check_planners, digests, network_for
from dc2g_jax._src.cli.episodes import EpisodeProgress, EpisodeTable
from dc2g_jax._src.cli.options import NetworkOptions, OutOptions, ResumeOptions, require_positive
from dc2g_jax._src.cli.outputs import command_written, output_folder, print_files
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.figures.results_figures import plot_leaderboard
from dc2g_jax._src.own_parts import is_own_part
from dc2g_jax._src.planning.named import NETWORK_RIVALS, RIVALS
from dc2g_jax._src.planning.rules import named_settings
from dc2g_jax._src.readers.families import FAMILIES, family_of, gather
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start, sample_starts
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.leaderboard import PRIVILEGED, leaders, page, standings
from dc2g_jax._src.rollouts.results import EpisodeResult

#: The planner that all are compared with.
_REFERENCE = "frontier"


@dataclasses.dataclass(frozen=True)
class Options(NetworkOptions, OutOptions, ResumeOptions):
    """Run planners from the same starts in families of maps; write a table, a figure and the page `leaderboard.md`.

    Attributes:
      planner: planners to compare, frontier among them; package.module:Name for one of your own, which
        dc2g_jax.check_planner should have passed.
      family: families of maps: `published` for the published houses, a folder of maps or of OpenStreetMap extracts,
        package.module:name for a `HouseDataset` of your own or a function that returns one, or a word; by default
        `published` and all words: `procedural`, `towns`, `mazes`, `halls`, `offices`, `floor_plans`.
      split: split of the maps. Choose and tune on `val`.
      maps: largest number of maps of a family.
      starts: least number of sampled starts in a family; each of its maps gets the same number.
      most_cells: largest number of cells of a map. Of a family with maps of several sizes, those of the largest size
        are taken.
      settings: rules, see `run`.
      seed: seed of the starts.
    """

    planner: PlannersOption = ("oracle", _REFERENCE, "dc2g", "dc2g_paper", *RIVALS, *NETWORK_RIVALS)
    family: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...", help_behavior_hint="")] = FAMILIES
    split: Literal["val", "test"] = "test"
    maps: int = 56
    starts: int = 112
    most_cells: int = 100 * 75
    settings: SettingsOption = "paper"
    seed: int = 0


def main(options: Options) -> None:
    """Run all planners in all families, and tell where each stands."""
    require_positive(options, "maps", "starts", "most_cells")
    check_planners(options.planner)
    compared = [name for name in options.planner if name != _REFERENCE and name not in PRIVILEGED]
    if _REFERENCE not in options.planner or not compared:
        raise InputError(
            f"--planner {' '.join(options.planner)}: give {_REFERENCE}, which others are compared with, and another "
            "one that does not know the map"
        )
    if not options.family:
        raise InputError("--family: is empty; give a family of maps")
    settings = named_settings(options.settings)
    dataset = gather(options.family, options.split, options.maps, options.most_cells)
    network = network_for(options.planner, options.network)
    out = output_folder(options, "compare", inputs=digests(dataset, network=network))
    table, began, used = EpisodeTable(out / "episodes.csv"), time.monotonic(), time.process_time()
    # A step limit for each size of map: planners that fail would take that of the largest on all.
    by_size: dict[tuple[int, ...], list[House]] = {}
    for house in dataset.houses:
        by_size.setdefault(house.terrain.shape, []).append(house)
    maps = Counter(family_of(house.name) for house in dataset.houses)
    runs: list[tuple[Runner, list[Start]]] = []
    limit: dict[str, int] = {}
    for own in by_size.values():
        runner = Runner(HouseDataset(dataset.name, dataset.source, tuple(own)), settings, progress=EpisodeProgress())
        counts = [-(-options.starts // maps[family_of(house.name)]) for house in own]
        starts = [sample_starts([house], count, seed=options.seed) for house, count in zip(own, counts, strict=True)]
        runs.append((runner, list(itertools.chain(*starts))))
        limit |= dict.fromkeys((house.name for house in own), runner.step_limit)
    results: list[EpisodeResult] = []
    for planner in options.planner:
        for runner, of_all in runs:
            results += table.run(runner, of_all, [planner], network)
    spent = f"{(time.monotonic() - began) / 60:.1f} minutes, {(time.process_time() - used) / 60:.1f} minutes of CPU"

    standing = standings(results, limit, _REFERENCE)
    about = [*filter(is_own_part, compared)] or [name for name in compared if name == "dc2g"] or compared
    first = {planner: leaders(results, limit, standing, planner) for planner in about}
    (out / "images").mkdir(exist_ok=True)
    plot_leaderboard(out / "images" / "leaderboard", standing)
    (out / "leaderboard.md").write_text(
        page(
            standing,
            first,
            maps=maps,
            settings=f"Settings `{options.settings}`,\n{settings.sensing_range}-cell sensing, split `{options.split}`.",
            how=f"{len(results):,} episodes of {len(options.planner)} planners, {' + '.join(maps)}: "
            f"`{command_written().replace(' --resume', '')}`.",
            figure="images/leaderboard.png",
        ),
        encoding="utf-8",
    )
    print((out / "leaderboard.md").read_text(encoding="utf-8"))
    print(f"{len(results):,} episodes; this run took {spent}")
    print_files(out)
