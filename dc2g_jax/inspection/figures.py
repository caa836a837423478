"""Figures to put in a paper: drawn off screen, readable in grey and by the colour-blind, as PNG and SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dc2g_jax.evaluation import Summary

Table = Mapping[str, Mapping[str, Summary]]

#: Planner -> label, colour (Okabe and Ito), hatch. The order is that of the bars.
_STYLE = {
    "authors_frontier": ("Frontier, authors' code", "#f5c99b", "///"),
    "frontier": ("Frontier", "#d55e00", ""),
    "authors_dc2g": ("DC2G, authors' network", "#a9d3ee", "///"),
    "dc2g": ("DC2G, this package", "#0072b2", ""),
    "true_cost_to_go": ("DC2G with exact cost-to-go", "#009e73", ""),
}
_GROUP_LABELS = {
    "train": "training\nhouses",
    "same_neighborhood": "same\nneighborhood",
    "new_neighborhood": "new\nneighborhood",
    "urban": "urban",
    "all": "all",
    "test": "all test\nhouses",
}
_TITLES = {
    "published": "The 400 published episodes, 5-cell sensing",
    "paper": "Sampled starts, 8-cell sensing",
}


def _bars(axes: Axes, table: Table, groups: Sequence[str]) -> None:
    """Grouped bars of the mean, with a tick at the median."""
    planners = [planner for planner in _STYLE if planner in table]
    width = 0.84 / len(planners)
    for place, planner in enumerate(planners):
        label, colour, hatch = _STYLE[planner]
        x = np.arange(len(groups)) + (place - (len(planners) - 1) / 2) * width
        mean = [table[planner][group].mean_extra for group in groups]
        median = [table[planner][group].median_extra for group in groups]
        axes.bar(x, mean, width * 0.92, label=label, color=colour, hatch=hatch, edgecolor="#333333", linewidth=0.6)
        axes.hlines(median, x - width * 0.46, x + width * 0.46, color="black", linewidth=1.8)
        for position, value in zip(x, mean, strict=True):
            axes.annotate(
                f"{value:.0f}" if value >= 10 else f"{value:.1f}",
                (position, value),
                xytext=(0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
            )
    axes.set_xticks(np.arange(len(groups)), [_GROUP_LABELS.get(group, group) for group in groups])
    axes.tick_params(axis="x", length=0)
    axes.yaxis.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plot_extra_steps(path: str | Path, tables: Mapping[str, Table], dataset: str) -> list[Path]:
    """Draw the bars of Fig. 7: mean extra steps beyond the oracle by planner and group, a panel for each setting.

    Args:
      path: where to write, without an ending.
      tables: setting -> planner -> group -> summary.
      dataset: what the houses are, for the caption.

    Returns:
      The files written: PNG and SVG.
    """
    panels = {settings: table for settings, table in tables.items() if table}
    groups = {settings: list(table["frontier"]) for settings, table in panels.items()}
    order = list(_GROUP_LABELS)
    for names in groups.values():
        names.sort(key=lambda name: order.index(name) if name in order else len(order))
    bars = [len(groups[s]) * sum(planner in _STYLE for planner in panels[s]) for s in panels]
    figure = Figure(figsize=(1.2 + 0.36 * sum(bars), 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    all_axes = figure.subplots(1, len(panels), squeeze=False, sharey=True, width_ratios=bars)[0]
    for axes, (settings, table) in zip(all_axes, panels.items(), strict=True):
        _bars(axes, table, groups[settings])
        axes.set_title(_TITLES.get(settings, settings), fontsize=10.5)
    all_axes[0].set_ylabel("extra steps beyond the oracle (%)")
    handles: dict[str, Artist] = {}
    for axes in all_axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = [style[0] for style in _STYLE.values() if style[0] in handles]
    figure.legend(
        [handles[label] for label in labels],
        labels,
        loc="outside upper center",
        ncols=len(labels),
        frameon=False,
        fontsize=9,
    )
    figure.supxlabel(f"Bars: mean; black lines: median. Houses: {dataset}.", fontsize=8, color="#555555")
    written = []
    for ending in (".png", ".svg"):
        target = Path(path).with_suffix(ending)
        figure.savefig(target, dpi=160)
        written.append(target)
    return written
