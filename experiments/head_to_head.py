"""Compare the authors' network with our planner, episode by episode: `python -m experiments.head_to_head`.

Both run the 400 published episodes with the same houses, starts and sensing. The authors published their step counts.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dc2g_jax.cli.common import PlannerOption, check_planners, command_line, digests, network_for
from dc2g_jax.cli.episodes import EpisodeProgress, EpisodeTable
from dc2g_jax.cli.options import DatasetOptions, NetworkOptions, OutOptions, ResumeOptions, require_positive
from dc2g_jax.cli.outputs import output_folder, print_files
from dc2g_jax.datasets.houses import HouseDataset, open_dataset
from dc2g_jax.datasets.starts import PublishedEpisode, published_episodes
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainedNetwork
from dc2g_jax.files.atomic import write_json
from dc2g_jax.files.tables import write_table
from dc2g_jax.inspection.figures import plot_head_to_head
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import EpisodeResult, Runner
from dc2g_jax.rollouts.rollout import STEP_LIMIT
from dc2g_jax.rollouts.statistics import extra_steps, house_bootstrap

#: Groups of the tables, in order; the last holds all episodes.
GROUPS = ("train", "same_neighborhood", "new_neighborhood", "urban", "all")


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, OutOptions, ResumeOptions):
    """Run DC2G from the 400 published starts and compare it with the authors' own runs, episode by episode.

    `--dataset` must hold the published houses.

    Attributes:
      planner: planner to compare instead of DC2G; package.module:Class for one of your own.
      resamples: bootstrap samples of the houses, for the intervals.
      seed: seed of the bootstrap.
    """

    planner: PlannerOption = "dc2g"
    resamples: int = 10_000
    seed: int = 0


class EpisodePair(NamedTuple):
    """One episode, both sides: what each row of `head_to_head.csv` holds.

    Attributes:
      house: name of the house.
      x: first column.
      y: first row.
      heading: first heading.
      group: of the house.
      oracle: actions of the oracle, ours.
      authors_oracle: actions of the authors' oracle.
      frontier: actions of frontier exploration, ours.
      authors_frontier: the authors'.
      dc2g: actions of ours: of DC2G, or of the planner in its place.
      authors_dc2g: the authors'.
      reached: did ours reach the door? Where it did not, its actions count as many as the step limit.
      extra: extra steps of ours beyond our oracle, in percent.
      authors_extra: the authors' DC2G beyond the authors' oracle.
    """

    house: str
    x: int
    y: int
    heading: int
    group: str
    oracle: int
    authors_oracle: int
    frontier: int
    authors_frontier: int
    dc2g: int
    authors_dc2g: int
    reached: bool
    extra: float
    authors_extra: float


def pair_up(
    published: Sequence[PublishedEpisode], frontier: Sequence[EpisodeResult], dc2g: Sequence[EpisodeResult]
) -> list[EpisodePair]:
    """Our results beside the authors', in the order of the published episodes."""

    def steps(result: EpisodeResult) -> int:
        return result.steps if result.success else STEP_LIMIT

    return [
        EpisodePair(
            house=theirs.start.house,
            x=theirs.start.x,
            y=theirs.start.y,
            heading=theirs.start.heading,
            group=theirs.group,
            oracle=ours.oracle_steps,
            authors_oracle=theirs.oracle,
            frontier=steps(blind),
            authors_frontier=theirs.frontier,
            dc2g=steps(ours),
            authors_dc2g=theirs.dc2g,
            reached=ours.success,
            extra=extra_steps(steps(ours), ours.oracle_steps),
            authors_extra=extra_steps(theirs.dc2g, theirs.oracle),
        )
        for theirs, blind, ours in zip(published, frontier, dc2g, strict=True)
    ]


def run_published(
    planner: str, dataset: HouseDataset, network: TrainedNetwork | None, table: EpisodeTable
) -> dict[str, list[EpisodeResult]]:
    """Episodes of frontier exploration and of a planner from the published starts, by planner."""
    runner = Runner(dataset, SETTINGS["published"], progress=EpisodeProgress())
    starts = [episode.start for episode in published_episodes()]
    return {name: table.run(runner, starts, [name], network) for name in dict.fromkeys(("frontier", planner))}


def compare(pairs: Sequence[EpisodePair], *, resamples: int, seed: int) -> dict[str, Any]:
    """The figures of one group of episodes. Intervals hold 95 % of `resamples` draws of its houses."""
    houses = [pair.house for pair in pairs]
    steps = np.array([(pair.dc2g, pair.authors_dc2g, pair.frontier, pair.authors_frontier) for pair in pairs], float)
    ours, authors, frontier, authors_frontier = steps.T
    extra = np.array([pair.extra for pair in pairs])
    authors_extra = np.array([pair.authors_extra for pair in pairs])
    shorter, longer = int(np.sum(ours < authors)), int(np.sum(ours > authors))

    def interval(values: np.ndarray) -> list[float]:
        return [round(bound, 4) for bound in house_bootstrap(values, houses, resamples=resamples, seed=seed)]

    faster, authors_faster = 100 * (frontier / ours - 1), 100 * (authors_frontier / authors - 1)
    return {
        "episodes": len(pairs),
        "houses": len(set(houses)),
        "mean_extra": round(float(extra.mean()), 4),
        "mean_extra_interval": interval(extra),
        "authors_mean_extra": round(float(authors_extra.mean()), 4),
        "difference": round(float(np.mean(extra - authors_extra)), 4),
        "difference_interval": interval(extra - authors_extra),
        "median_extra": round(float(np.median(extra)), 4),
        "authors_median_extra": round(float(np.median(authors_extra)), 4),
        "shorter": shorter,
        "equal": len(pairs) - shorter - longer,
        "longer": longer,
        "shorter_of_differing": round(shorter / max(1, shorter + longer), 4),
        "time_outs": sum(not pair.reached for pair in pairs),
        "authors_time_outs": int(np.sum(authors >= STEP_LIMIT)),
        "frontier_over_dc2g": round(float(faster.mean()), 4),
        "frontier_over_dc2g_interval": interval(faster),
        "authors_frontier_over_dc2g": round(float(authors_faster.mean()), 4),
    }


def print_comparison(tables: dict[str, dict[str, Any]]) -> None:
    """Print the comparisons, one column per group."""
    rows = (
        ("episodes", "{episodes}"),
        ("mean extra steps, ours %", "{mean_extra:.1f}"),
        ("  95 % interval", "{mean_extra_interval[0]:.1f} to {mean_extra_interval[1]:.1f}"),
        ("mean extra steps, authors' %", "{authors_mean_extra:.1f}"),
        ("ours less authors'", "{difference:+.1f}"),
        ("  95 % interval", "{difference_interval[0]:+.1f} to {difference_interval[1]:+.1f}"),
        ("median, ours %", "{median_extra:.1f}"),
        ("median, authors' %", "{authors_median_extra:.1f}"),
        ("ours shorter / equal / longer", "{shorter} / {equal} / {longer}"),
        ("shorter of those that differ", "{shorter_of_differing:.1%}"),
        ("time-outs, ours / authors'", "{time_outs} / {authors_time_outs}"),
        ("frontier / dc2g - 1, ours %", "{frontier_over_dc2g:.1f}"),
        ("frontier / dc2g - 1, authors' %", "{authors_frontier_over_dc2g:.1f}"),
    )
    print(f"\n{'':34}" + "".join(f"{group:>20}" for group in tables))
    for label, cell in rows:
        print(f"{label:34}" + "".join(f"{cell.format(**table):>20}" for table in tables.values()))


def main(options: Options) -> None:
    """Run the episodes, compare them, write the tables."""
    require_positive(options, "resamples")
    dataset = open_dataset(options.dataset)
    if dataset.source != "published":
        raise InputError(
            f"{dataset.name}: the authors' episodes are in the published houses; give --dataset with a copy of them"
        )
    check_planners([options.planner])
    network = network_for([options.planner], options.network)
    out = output_folder(options, "head_to_head", inputs=digests(dataset, network=network))
    results = run_published(options.planner, dataset, network, EpisodeTable(out / "episodes.csv"))
    pairs = pair_up(published_episodes(), results["frontier"], results[options.planner])
    groups = {group: [pair for pair in pairs if group in (pair.group, "all")] for group in GROUPS}
    tables = {group: compare(own, resamples=options.resamples, seed=options.seed) for group, own in groups.items()}
    print_comparison(tables)
    by_house = {house: [pair for pair in pairs if pair.house == house] for house in sorted({p.house for p in pairs})}
    beaten = [
        house for house, own in by_house.items() if np.mean([p.frontier for p in own]) < np.mean([p.dc2g for p in own])
    ]
    print(f"\nHouses in which frontier exploration is shorter on average: {len(beaten)} of {len(by_house)}")
    rows = [pair._replace(extra=round(pair.extra, 4), authors_extra=round(pair.authors_extra, 4)) for pair in pairs]
    write_table(out / "head_to_head.csv", EpisodePair._fields, rows)
    facts = {
        "planner": options.planner,
        "dataset": dataset.name,
        "resamples": options.resamples,
        "seed": options.seed,
        "groups": tables,
        "houses_where_frontier_is_shorter": beaten,
    }
    write_json(out / "results.json", facts)
    plot_head_to_head(
        out / "head_to_head",
        {group: [(pair.authors_extra, pair.extra) for pair in groups[group]] for group in GROUPS[:-1]},
    )
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
