"""The bars of Fig. 7: mean extra steps by planner and group of houses."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dc2g_jax._src.figures.results_figures import (
    GROUP_LABELS,
    PAGE_WIDTH,
    PlannerStyle,
    group_place,
    plain_axes,
    planner_styles,
    save_figure,
)
from dc2g_jax._src.runtime.errors import InputError
from experiments.support.groups import Table

#: Titles of figures by settings.
TITLES = {"published": "The 400 published episodes, 5-cell sensing", "paper": "Sampled starts, 8-cell sensing"}


def _rounded(value: float) -> str:
    """A number of percent, as below bars."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _bars(axes: Axes, table: Table, groups: Sequence[str], styles: Mapping[str, PlannerStyle]) -> None:
    """Draw grouped bars of the mean with its interval, and a line at the median. Below each bar is its mean."""
    planners = [planner for planner in styles if planner in table]
    width = 0.92 / len(planners)
    means = [table[planner][group]["mean_extra"] for planner in planners for group in groups]
    longest = max(len(_rounded(mean)) for mean in means)
    upright = 0.9 * 72 * PAGE_WIDTH * width / len(groups) < 4.7 * longest  # too wide to be side by side
    for place, planner in enumerate(planners):
        _, color, hatch, _ = styles[planner]
        x = np.arange(len(groups)) + (place - (len(planners) - 1) / 2) * width
        rows = [table[planner][group] for group in groups]
        names = ("mean_extra", "median_extra", "mean_low", "mean_high")
        mean, median, low, high = ([row[name] for row in rows] for name in names)
        axes.bar(x, mean, width * 0.92, color=color, hatch=hatch, edgecolor="#333333", linewidth=0.5)
        axes.vlines(x, low, high, color="white", linewidth=2.2)
        axes.hlines(median, x - width * 0.46, x + width * 0.46, color="black", linewidth=1.4)
        axes.vlines(x, low, high, color="#333333", linewidth=1.0)
        for position, value in zip(x, mean, strict=True):
            axes.annotate(
                _rounded(value),
                (position, 0),
                xycoords=("data", "axes fraction"),
                xytext=(0, -3),
                textcoords="offset points",
                ha="center",
                va="top",
                rotation=90 if upright else 0,
                fontsize=7,
            )
    axes.set_xticks(np.arange(len(groups)), [GROUP_LABELS.get(group, group) for group in groups])
    axes.set_xlim(-0.5, len(groups) - 0.5)
    plain_axes(axes, grid="y", label_size=7.5)
    axes.tick_params(axis="x", length=0, pad=8 + 4.5 * longest if upright else 13)


def plot_extra_steps(path: str | Path, tables: Mapping[str, Table], caption: str) -> list[Path]:
    """Draw the bars of Fig. 7: mean extra steps beyond the oracle by planner and group, with a panel per setting.

    Args:
      path: output path without ending.
      tables: setting -> planner -> group -> summary.
      caption: description of the runs, such as houses and network.

    Returns:
      The files written: PNG, SVG and PDF.

    Raises:
      InputError: no planner but the oracle.
    """
    panels = {settings: table for settings, table in tables.items() if table.keys() - {"oracle"}}
    if not panels:
        raise InputError("no planner to compare with the oracle: give the table of another one as well")
    figure = Figure(figsize=(PAGE_WIDTH, 0.8 + 2.2 * len(panels)), layout="constrained")
    all_axes = figure.subplots(len(panels), 1, squeeze=False, sharey=True)[:, 0]
    styles = planner_styles(name for table in panels.values() for name in table if name != "oracle")
    for axes, (settings, table) in zip(all_axes, panels.items(), strict=True):
        _bars(axes, table, sorted(next(iter(table.values())), key=group_place), styles)
        axes.set_title(TITLES.get(settings, settings), fontsize=8.5)
    figure.supylabel("extra steps beyond the oracle (%)", fontsize=8)
    patches = [
        Patch(facecolor=style.color, hatch=style.hatch, edgecolor="#333333", linewidth=0.5, label=style.label)
        for style in styles.values()
    ]
    columns = 2 if len(styles) == 4 else min(len(styles), 3)
    figure.legend(handles=patches, loc="outside upper center", ncols=columns, frameon=False, fontsize=7.5)
    note = "Bars, numbers: mean, with its 95 % interval over houses; black lines: median."
    figure.supxlabel(textwrap.fill(f"{note} {caption}", 140), fontsize=7, color="#555555")
    return save_figure(figure, path, dpi=300)
