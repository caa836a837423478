"""Compare the authors' network with our planner, episode by episode: `python -m experiments.head_to_head`.

Both run the 400 published episodes with the same houses, starts and sensing. The authors published their step counts.
"""

import dataclasses
from typing import Any

from dc2g_jax._src.cli.common import PlannerOption, check_planners, command_line, digests, network_for
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, ResumeOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.figures.results_figures import plot_head_to_head
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.tables import text_table, write_table
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import published_episodes
from experiments.support import published
from experiments.support.published import PUBLISHED_GROUPS


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, OutOptions, ResumeOptions):
    """Run DC2G from the 400 published starts and compare it with the authors' own runs, episode by episode.

    `--dataset` must hold the published houses.

    Attributes:
      planner: planner to compare instead of DC2G; package.module:Name for one of your own.
      resamples: bootstrap samples of the houses, for the intervals.
      seed: seed of the bootstrap.
    """

    planner: PlannerOption = "dc2g"
    resamples: int = 10_000
    seed: int = 0


def _print_comparison(tables: dict[str, dict[str, Any]]) -> None:
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
    cells = ((label, *(cell.format(**table) for table in tables.values())) for label, cell in rows)
    print(f"\n{text_table(('', *tables), cells)}")


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
    both = tuple(dict.fromkeys(("frontier", options.planner)))
    ran = published.run_published(EpisodeTable(out / "episodes.csv"), dataset, both, network)
    frontier, ours = ([one for one in ran if one.planner == name] for name in ("frontier", options.planner))
    pairs = published.pair_up(published_episodes(), frontier, ours)
    groups = published.by_group(pairs)
    bootstrap = {"resamples": options.resamples, "seed": options.seed}
    tables = {group: published.compare(own, **bootstrap) for group, own in groups.items()}
    _print_comparison(tables)
    shorter, count = published.houses_where_frontier_is_shorter(pairs), len({pair.house for pair in pairs})
    print(f"\nHouses of {count} in which frontier exploration is shorter on average:")
    for whose, houses in shorter.items():
        print(f"  {whose}: {len(houses)} {' '.join(houses)}")
    rows = [pair._replace(extra=round(pair.extra, 4), authors_extra=round(pair.authors_extra, 4)) for pair in pairs]
    write_table(out / "head_to_head.csv", published.EpisodePair._fields, rows)
    facts = {
        "planner": options.planner,
        "dataset": dataset.name,
        **bootstrap,
        "groups": tables,
        "houses_where_frontier_is_shorter": shorter,
    }
    write_json(out / "results.json", facts)
    plot_head_to_head(
        out / "head_to_head",
        {group: [(pair.authors_extra, pair.extra) for pair in groups[group]] for group in PUBLISHED_GROUPS[:-1]},
    )
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
