"""Compare planners in families of maps: `dc2g compare`."""

import dataclasses
import datetime
import itertools
import re
import time
from collections import Counter
from collections.abc import Iterable
from typing import Annotated, Literal

import tyro

from dc2g_jax._src.cli.common import FieldOfViewOption, PlannersOption, SettingsOption, check_planners, digests
from dc2g_jax._src.cli.episodes import EpisodeTable, NetworksOptions
from dc2g_jax._src.cli.options import OutOptions, ResumeOptions, require_positive
from dc2g_jax._src.cli.outputs import command_written, output_folder, print_files
from dc2g_jax._src.figures.results_figures import plot_leaderboard
from dc2g_jax._src.grid.sensing import PAPER_DEGREES
from dc2g_jax._src.planning.named import NETWORK_RIVALS, RIVALS
from dc2g_jax._src.planning.rules import Settings, named_settings
from dc2g_jax._src.readers.families import FAMILIES, family_of, field_of_view_of, gather
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start, sample_starts
from dc2g_jax._src.rollouts.evaluation import Runner, by_name
from dc2g_jax._src.rollouts.leaderboard import PRIVILEGED, REFERENCE, families_of, page
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.own_parts import is_own_part
from dc2g_jax._src.runtime.programs import count_programs
from dc2g_jax._src.runtime.progress import EpisodeProgress


@dataclasses.dataclass(frozen=True)
class Options(NetworksOptions, OutOptions, ResumeOptions):
    """Run planners from the same starts in families of maps; write a table, a figure and the page `leaderboard.md`.

    Attributes:
      planner: planners to compare, frontier among them; package.module:Name for one of your own, which
        dc2g_jax.check_planner should have passed.
      family: families of maps: `published` for the published houses, a folder of maps or of OpenStreetMap extracts,
        package.module:name for a `HouseDataset` of your own or a function that returns one, or a word; by default
        `published` and all words: `procedural`, `towns`, `mazes`, `halls`, `offices`, `floor_plans`. With @ and a width
        in degrees, its robots have that field of view, as in `offices@360`, which is a default, too.
      split: split of the maps. Choose and tune on `val`.
      maps: largest number of maps of a family.
      starts: least number of sampled starts in a family; each of its maps gets the same number.
      most_cells: largest number of cells of a map. Of a family with maps of several sizes, those of the largest size
        are taken.
      settings: rules, see `run`.
      field_of_view: width of the robots' field of view in degrees, see `run`.
      seed: seed of the starts.
    """

    planner: PlannersOption = ("oracle", REFERENCE, "dc2g", "dc2g_paper", *RIVALS, *NETWORK_RIVALS)
    family: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...", help_behavior_hint="")] = FAMILIES
    split: Literal["val", "test"] = "test"
    maps: int = 56
    starts: int = 112
    most_cells: int = 100 * 75
    settings: SettingsOption = "paper"
    field_of_view: FieldOfViewOption = None
    seed: int = 0


def main(options: Options) -> None:
    """Run all planners in all families, and tell where each stands."""
    require_positive(options, "maps", "starts", "most_cells")
    check_planners(options.planner)
    if REFERENCE not in options.planner or not {*options.planner} - {REFERENCE, *PRIVILEGED}:
        raise InputError(
            f"--planner {' '.join(options.planner)}: give {REFERENCE}, which others are compared with, and another one "
            "that does not know the map"
        )
    if not options.family:
        raise InputError("--family: is empty; give a family of maps")
    common = named_settings(options.settings, options.field_of_view)
    dataset = gather(options.family, options.split, options.maps, options.most_cells)
    settings = {
        family: named_settings(common, field_of_view_of(family)[1])
        for family in dict.fromkeys(family_of(house.name) for house in dataset.houses)
    }
    network = options.open(options.planner)
    planners = by_name(options.planner, network)
    out = output_folder(options, "compare", inputs=digests(dataset, network=network))
    began, programs = datetime.datetime.now(datetime.UTC), count_programs()
    table, start, used = EpisodeTable(out / "episodes.csv"), time.monotonic(), time.process_time()
    # A step limit for each size of map: planners that fail would take that of the largest on all.
    alike: dict[tuple[tuple[int, ...], Settings], list[House]] = {}
    for house in dataset.houses:
        alike.setdefault((house.terrain.shape, settings[family_of(house.name)]), []).append(house)
    maps = Counter(family_of(house.name) for house in dataset.houses)
    runs: list[tuple[Runner, list[Start]]] = []
    limit: dict[str, int] = {}
    for (_, seen), own in alike.items():
        runner = Runner(HouseDataset(dataset.name, dataset.source, tuple(own)), seen, progress=EpisodeProgress())
        counts = [-(-options.starts // maps[family_of(house.name)]) for house in own]
        starts = [sample_starts([house], count, seed=options.seed) for house, count in zip(own, counts, strict=True)]
        runs.append((runner, list(itertools.chain(*starts))))
        limit |= dict.fromkeys((house.name for house in own), runner.step_limit)
    results: list[EpisodeResult] = []
    for planner, source in planners.items():
        for runner, of_all in runs:
            results += table.run(runner, of_all, {planner: source})
    spent = f"{(time.monotonic() - start) / 60:.1f} minutes, {(time.process_time() - used) / 60:.1f} minutes of CPU"
    spent += f"; {len(programs)} programs were compiled or loaded in {sum(programs) / 60:.1f} minutes"

    families = families_of(results, limit)
    (out / "images").mkdir(exist_ok=True)
    plot_leaderboard(out / "images" / "leaderboard", families)
    command = re.sub(r" --(out ('[^']*'|\S+)|resume)", "", command_written())
    degrees = common.field_of_view
    others = " (after @: another width)" if any(field_of_view_of(family)[1] for family in settings) else ""
    wide = f" over {degrees:g} degrees{others}" if others or degrees != PAPER_DEGREES else ""
    sees = f"{common.sensing_range}-cell sensing{wide}"
    text = page(
        families,
        _about(planners),
        settings=f"Settings `{options.settings}`,\n{sees}, split `{options.split}`.",
        how=f"{len(results):,} episodes of {len(planners)} planners in {len(families)} "
        f"{'family' if len(families) == 1 else 'families'}: `{command}` ({began:%Y-%m-%d}).",
        figure="images/leaderboard.png",
    )
    (out / "leaderboard.md").write_text(text, encoding="utf-8")
    print(text)
    print(f"{len(results):,} episodes; this run took {spent}")
    print_files(out)


def _about(planners: Iterable[str]) -> list[str]:
    """The planners that the page tells about: the user's own, or `dc2g` with each network, or all."""
    compared = [name for name in planners if name not in (REFERENCE, *PRIVILEGED)]
    own = [name for name in compared if is_own_part(name)]
    return own or [name for name in compared if name.partition(" ")[0] == "dc2g"] or compared
