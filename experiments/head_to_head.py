"""Compare the authors' network with our planner, episode by episode: `python -m experiments.head_to_head`.

Both run the 400 published episodes with the same houses, starts and sensing. The authors published their step counts.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dc2g_jax._src.cli.common import check_planners, command_line, digests, network_for
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, ResumeOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.figures.results_figures import GROUP_LABELS, PAGE_WIDTH, SCALE_NOTE, save_figure, scale_extra_steps
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.tables import text_table, write_table
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import published_episodes
from dc2g_jax._src.runtime.errors import InputError
from experiments.support import published
from experiments.support.commands import PlannerOption
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


def plot_head_to_head(path: str | Path, extra: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    """Draw one point per episode, the authors' extra steps along x, ours along y, with a panel per group of houses.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      extra: group -> (authors', ours) of each episode, in percent.
    """
    rows = -(-len(extra) // 2)
    figure = Figure(figsize=(PAGE_WIDTH, 3.5 * rows + 0.3), layout="constrained")
    all_axes = figure.subplots(rows, 2, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in all_axes[len(extra) :]:
        axes.remove()
    most = max(value for pairs in extra.values() for pair in pairs for value in pair)
    ends = (-4.0, 1.6 * most)
    for axes, (group, pairs) in zip(all_axes, extra.items(), strict=False):
        authors, ours = np.array(pairs, float).T
        below, above = int(np.sum(ours < authors)), int(np.sum(ours > authors))
        axes.fill_between(ends, ends, ends[0], color="#0072b2", alpha=0.08, linewidth=0)
        axes.plot(ends, ends, color="#555555", linewidth=0.8)
        axes.plot(authors, ours, "o", color="#0072b2", markeredgecolor="white", markeredgewidth=0.4, markersize=5)
        axes.plot(authors.mean(), ours.mean(), "X", color="#d55e00", markeredgecolor="black", markersize=10)
        for direction in "xy":
            scale_extra_steps(axes, direction, ends)
        axes.grid(True, color="#dddddd", linewidth=0.5)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8)
        axes.set_aspect("equal")
        axes.set_title(GROUP_LABELS.get(group, group).replace("\n", " "), fontsize=10)
        style: dict[str, Any] = {"xycoords": "axes fraction", "fontsize": 8.5, "color": "#333333"}
        axes.annotate(f"lower in {below} episodes", (0.97, 0.04), ha="right", **style)
        axes.annotate(f"higher in {above} episodes", (0.03, 0.93), ha="left", **style)
    figure.supylabel("extra steps, this package (%)", fontsize=9)
    figure.supxlabel(
        f"extra steps, authors' network (%)\ncross: means; each against its own oracle; axes {SCALE_NOTE}", fontsize=9
    )
    save_figure(figure, path, dpi=200)


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
