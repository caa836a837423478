"""The paper's headline figure: extra steps beyond an oracle, by planner and neighborhood.

`python -m experiments.reproduce_fig7` runs the 400 published episodes, and sampled starts in every test house.
"""

import dataclasses
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from dc2g_jax._src.cli.common import PlannersOption, check_planners, command_line, digests, network_for
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, ResumeOptions, StepLimitOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.figures._sheets import spread
from dc2g_jax._src.figures.episode_figures import plot_episode
from dc2g_jax._src.figures.replay import replay_result
from dc2g_jax._src.figures.results_figures import plot_results
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.tables import text_table, write_table
from dc2g_jax._src.planning.named import FIGURE_PLANNERS
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import PROCEDURAL, HouseDataset, group_of, open_dataset, tell_on_stderr
from dc2g_jax._src.readers.starts import Start, sample_starts, usable_houses, why_no_episode
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax._src.viewer.recording import record_episode
from experiments.support.bars import TITLES, plot_extra_steps
from experiments.support.groups import Table, tabulate
from experiments.support.published import PUBLISHED_GROUPS, authors_results, group_by_house, run_published


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, StepLimitOptions, OutOptions, ResumeOptions):
    """Reproduce Fig. 7: extra steps, in percent of an oracle's, that each planner needs to find a front door.

    Attributes:
      settings: `published` runs the paper's 400 episodes (5-cell sensing; published dataset only), `paper` runs
        sampled starts in every test house with 8-cell sensing, `both` runs both.
      planner: planners to compare; package.module:Name for one of your own, which dc2g_jax.check_planner should have
        passed.
      starts_per_house: sampled starts in each test house.
      seed: seed of the sampled starts.
      record: write rerun recordings (.rrd) and figures of three episodes of each setting.
    """

    settings: Literal["both", "published", "paper"] = "both"
    planner: PlannersOption = FIGURE_PLANNERS
    starts_per_house: int = 10
    seed: int = 0
    record: bool = False


#: Number of episodes of each setting that `--record` records, spread evenly.
_RECORDED = 3

#: Groups of the sampled episodes in tables, in order; `test` holds all episodes.
_PAPER_GROUPS = ("same_neighborhood", "new_neighborhood", "urban", "test")

#: Number of summary columns for a single house, which has no interval over houses.
_OF_A_HOUSE = 6


def drawn(planners: Sequence[str]) -> list[str]:
    """Planners in figures of single houses: DC2G, frontier exploration and the user's own; all if none of these ran."""
    ran = [planner for planner in planners if planner != "oracle"]
    return [planner for planner in ran if planner in ("dc2g", "frontier") or planner not in FIGURE_PLANNERS] or ran


def record(
    out: Path, dataset: HouseDataset, settings: str, results: list[EpisodeResult], network: Estimator | None
) -> None:
    """Write rerun recordings and figures of `_RECORDED` episodes, spread evenly."""
    rules = SETTINGS[settings].rules()
    planners = list(dict.fromkeys(result.planner for result in results))
    n_starts = len(results) // len(planners)
    chosen = spread(n_starts - 1, min(_RECORDED, n_starts))
    for number in tqdm(chosen, desc=f"{'recordings':>16}", unit="episode", file=sys.stderr):
        by_planner = {result.planner: result for result in results[number::n_starts] if result.planner != "oracle"}
        start = results[number]
        name = f"{settings}-{start.house}-x{start.x}-y{start.y}-h{start.heading}"
        house = dataset.house(start.house)
        frames = {planner: replay_result(result, house, rules, network) for planner, result in by_planner.items()}
        path = out / "recordings" / f"{name}.rrd"
        record_episode(path, house=house, result_by_planner=by_planner, frames_by_planner=frames)
        shown = {planner: frames[planner] for planner in sorted(drawn(planners))}
        plot_episode(out / "recordings" / name, house, shown)


def table_text(title: str, table: Table, groups: tuple[str, ...]) -> str:
    """Mean and median extra steps by planner and group."""
    present = [group for group in groups if any(group in row for row in table.values())]
    rows = [
        (
            planner,
            *(f"{row[group]['mean_extra']:.1f} ({row[group]['median_extra']:.1f})" for group in present),
            f"{100 * row[groups[-1]]['success']:.1f} %",
        )
        for planner, row in table.items()
        if planner != "oracle"
    ]
    return f"\n{title}\nmean extra steps beyond the oracle, % (median)\n{text_table(('', *present, 'success'), rows)}"


def _write_tables(
    out: Path,
    tables: dict[str, Table],
    entries: dict[str, list[EpisodeResult]],
    groups: Mapping[str, Mapping[str, str]],
) -> None:
    """Write `summary.csv` (by planner and group) and `houses.csv` (by planner and house)."""
    names = list(next(summary for table in tables.values() for row in table.values() for summary in row.values()))
    summaries = [
        (settings, planner, group, *(round(value, 4) for value in summary.values()))
        for settings, table in tables.items()
        for planner, row in table.items()
        for group, summary in row.items()
    ]
    write_table(out / "summary.csv", ("settings", "planner", "group", *names), summaries)
    rows = []
    for settings, episodes in entries.items():
        houses = dict.fromkeys(one.house for one in episodes)
        for planner, row in tabulate(episodes, (*houses, "all"), {house: house for house in houses}).items():
            for house in houses:
                values = (round(value, 4) for value in [*row[house].values()][:_OF_A_HOUSE])
                rows.append((settings, planner, house, groups[settings][house], *values))
    columns = ("settings", "planner", "house", "group", *names[:_OF_A_HOUSE])
    write_table(out / "houses.csv", columns, rows)


def _as_json(table: Table) -> dict[str, dict[str, dict[str, float]]]:
    """The columns of a table that `results.json` holds."""
    keys = ("mean_extra", "mean_low", "mean_high", "median_extra", "success", "episodes")
    return {
        planner: {group: {key: summary[key] for key in keys} for group, summary in row.items()}
        for planner, row in table.items()
    }


def main(options: Options) -> None:
    """Run the episodes; print, write and plot their tables."""
    began = time.perf_counter()
    check_planners(options.planner)
    if options.planner == ("oracle",):
        raise InputError("--planner oracle: give a planner to compare with the oracle")
    dataset = open_dataset(options.dataset)
    if options.settings == "published" and dataset.source != "published":
        raise InputError(
            f"{dataset.name}: the 400 published episodes need the published houses; give --dataset with a copy of "
            "them, or --settings paper for sampled starts"
        )
    network = network_for(options.planner, options.network)
    starts: list[Start] = []
    if options.settings != "published":  # the same number in every house that can be run: houses weigh equally
        starts = sample_starts(usable_houses(dataset, "test"), options.starts_per_house, seed=options.seed)
    runner = Runner(dataset, SETTINGS["paper"], step_limit=options.step_limit, progress=EpisodeProgress())
    out = output_folder(options, "reproduce_fig7", inputs=digests(dataset, network=network))
    table = EpisodeTable(out / "episodes.csv")
    label = "procedural houses" if dataset.name == PROCEDURAL else dataset.name
    tables: dict[str, Table] = {}
    entries: dict[str, list[EpisodeResult]] = {}
    results: dict[str, list[EpisodeResult]] = {}
    groups: dict[str, dict[str, str]] = {}
    if options.settings != "paper" and dataset.source == "published":
        results["published"] = run_published(table, dataset, options.planner, network)
        entries["published"] = results["published"] + authors_results()
        groups["published"] = group_by_house()
        tables["published"] = tabulate(entries["published"], PUBLISHED_GROUPS, groups["published"])
        title = f"The 400 published episodes, 5-cell sensing ({label})"
        print(table_text(title, tables["published"], PUBLISHED_GROUPS))
    elif options.settings != "paper":
        tell_on_stderr(f"Left out: the 400 published episodes, which need the published houses, not {dataset.name}")
    if options.settings != "published":
        for house in dataset.split("test"):
            if reason := why_no_episode(house):
                tell_on_stderr(f"Left out: house {house.name}: {reason}")
        results["paper"] = table.run(runner, starts, options.planner, network)
        entries["paper"] = results["paper"]
        groups["paper"] = {house.name: group_of(house) for house in dataset.houses}
        tables["paper"] = tabulate(entries["paper"], _PAPER_GROUPS, groups["paper"])
        houses = len({start.house for start in starts})
        title = f"Sampled starts, {options.starts_per_house} in each of {houses} test houses, 8-cell sensing ({label})"
        print(table_text(title, tables["paper"], _PAPER_GROUPS))
    _write_tables(out, tables, entries, groups)
    whose = "" if options.network is None else f" Network: {options.network}."
    plot_extra_steps(out / "fig7", tables, f"Houses: {label}.{whose}")
    for settings, part in results.items():
        compared = [result for result in part if result.planner in drawn(options.planner)]
        plot_results(compared, out / f"houses_{settings}", groups[settings], f"{TITLES[settings]} ({label})")
        if options.record:
            record(out, dataset, settings, part, network)
    facts = {
        "dataset": dataset.name,
        "source": dataset.source,
        "seed": options.seed,
        "seconds": round(time.perf_counter() - began, 1),
        "published": _as_json(tables.get("published", {})),
        "paper": _as_json(tables.get("paper", {})),
    }
    write_json(out / "results.json", facts)
    print(f"\nThis run took {facts['seconds']} s")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
