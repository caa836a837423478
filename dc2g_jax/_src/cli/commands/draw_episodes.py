"""Draw figures of earlier episodes: `dc2g draw episodes outputs/RUN/episodes.csv`."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from dc2g_jax._src.cli.common import PlannersOption
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.figures.episode_figures import plot_trajectories
from dc2g_jax._src.figures.results_figures import plot_results
from dc2g_jax._src.files.rows import read_rows
from dc2g_jax._src.readers.houses import group_of, open_dataset
from dc2g_jax._src.readers.starts import published_episodes
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, OutOptions):
    """Draw episodes from an `episodes.csv`: extra steps by house, and the paths of planners on the map.

    Each sensing range has its own figure. `--dataset` must be the dataset of that run.

    Attributes:
      episodes: the `episodes.csv` of an earlier run.
      planner: planners to draw, by their names in that run; all of them by default.
      house: houses to draw paths in, one figure per start.
    """

    episodes: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CSV")]
    planner: Annotated[PlannersOption, tyro.conf.arg(metavar="NAME ...", help_behavior_hint="")] = ()
    house: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...", help_behavior_hint="")] = ()


def _ranges_of(result: EpisodeResult) -> str:
    """The sensing ranges of an episode, as part of a file name."""
    return f"-r{result.range}" + (f"-e{result.expanding_range}" if result.expanding_range else "")


def main(options: Options) -> None:
    """Read the episodes and draw them."""
    dataset = open_dataset(options.dataset)
    results = read_rows(options.episodes, EpisodeResult)
    if options.planner:
        results = [result for result in results if result.planner in options.planner]
    if not results:
        raise InputError(f"{options.episodes}: has no episode of {' or '.join(options.planner)}; give other --planner")
    compared: dict[str, list[EpisodeResult]] = {}
    for one in results:
        if one.planner != "oracle" and one.extra is not None:
            compared.setdefault(_ranges_of(one), []).append(one)
    if not compared and not options.house:
        raise InputError(
            f"{options.episodes}: extra steps are counted from the oracle's to a door; give another --planner as well, "
            "or a --house to draw paths in"
        )
    published = (
        {start.house: group for start, group, _ in published_episodes()} if dataset.source == "published" else {}
    )
    houses = {one.house for one in results}
    group_by_house = {house: published.get(house) or group_of(dataset.house(house)) for house in houses}
    for name in options.house:
        if name not in group_by_house:
            raise InputError(f"{options.episodes}: has no episode in {name}; give another --house")
    out = output_folder(options, "draw_episodes")
    for ranges, some in compared.items():
        name = f"houses{ranges if len(compared) > 1 else ''}"
        plot_results(some, out / name, group_by_house, f"{some[0].range}-cell sensing")
    by_start: dict[str, dict[str, EpisodeResult]] = {}
    for one in results:
        if one.house in options.house:
            name = f"{one.house}-x{one.x}-y{one.y}-h{one.heading}{_ranges_of(one)}"
            by_start.setdefault(name, {})[one.planner] = one
    for name, own in tqdm(by_start.items(), desc="drawing", unit="figure", file=sys.stderr):
        plot_trajectories(out / name, dataset.house(next(iter(own.values())).house), own)
    print_files(out)
