"""Figures to put in a paper: drawn off screen, readable in grey and by the colour-blind, as PNG and SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dc2g_jax.datasets.houses import House
from dc2g_jax.evaluation import Summary
from dc2g_jax.grid.terrain import CLASS_COLORS, CLASS_NAMES, TRAVERSABLE
from dc2g_jax.inspection.replay import Frames

Table = Mapping[str, Mapping[str, Summary]]

#: Planner -> label, colour (Okabe and Ito), hatch. The order is that of the bars.
_STYLE = {
    "authors_frontier": ("Frontier, authors' code", "#f5c99b", "///"),
    "frontier": ("Frontier", "#d55e00", ""),
    "authors_dc2g": ("DC2G, authors' network", "#a9d3ee", "///"),
    "dc2g": ("DC2G, this package", "#0072b2", ""),
    "dc2g_uncertain": ("DC2G, averse to risk", "#cc79a7", ""),
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


def save_figure(figure: Figure, path: str | Path) -> list[Path]:
    """Write a figure as PNG and SVG."""
    FigureCanvasAgg(figure)
    written = [Path(path).with_suffix(ending) for ending in (".png", ".svg")]
    for target in written:
        figure.savefig(target, dpi=160)
    return written


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
    return save_figure(figure, path)


def plot_head_to_head(path: str | Path, extra: Mapping[str, Sequence[tuple[float, float]]]) -> list[Path]:
    """Draw a point an episode: the authors' extra steps across, ours up; a panel for each group of houses.

    Args:
      path: where to write, without an ending.
      extra: group -> (authors', ours) of each episode, in percent.

    Returns:
      The files written: PNG and SVG.
    """
    figure = Figure(figsize=(3.1 * len(extra) + 0.4, 3.9), layout="constrained")
    all_axes = figure.subplots(1, len(extra), squeeze=False, sharex=True, sharey=True)[0]
    most = max(value for pairs in extra.values() for pair in pairs for value in pair)
    ends = (-4.0, 1.6 * most)
    for axes, (group, pairs) in zip(all_axes, extra.items(), strict=True):
        authors, ours = np.array(pairs, float).T
        below, above = int(np.sum(ours < authors)), int(np.sum(ours > authors))
        axes.fill_between(ends, ends, ends[0], color="#0072b2", alpha=0.08, linewidth=0)
        axes.plot(ends, ends, color="#555555", linewidth=0.8)
        axes.plot(authors, ours, "o", color="#0072b2", markeredgecolor="white", markeredgewidth=0.4, markersize=5)
        axes.plot(authors.mean(), ours.mean(), "X", color="#d55e00", markeredgecolor="black", markersize=10)
        # The scale is linear up to 10 % and logarithmic beyond, so that episodes without extra steps can be shown.
        for scale, limits in ((axes.set_xscale, axes.set_xlim), (axes.set_yscale, axes.set_ylim)):
            scale("symlog", linthresh=10, linscale=0.6)
            limits(*ends)
        ticks = [tick for tick in (0, 10, 30, 100, 300, 1000, 3000) if tick < ends[1]]
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.set_yticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
        axes.grid(True, color="#dddddd", linewidth=0.5)
        axes.set_axisbelow(True)
        axes.set_aspect("equal")
        axes.set_title(_GROUP_LABELS.get(group, group).replace("\n", " "), fontsize=10)
        for place, text in (((0.97, 0.04), f"lower in {below}"), ((0.03, 0.93), f"higher in {above}")):
            side = "right" if place[0] > 0.5 else "left"
            axes.annotate(text, place, xycoords="axes fraction", ha=side, fontsize=8.5, color="#333333")
    all_axes[0].set_ylabel("extra steps, this package (%)")
    figure.supxlabel("extra steps, authors' network (%)      cross: means", fontsize=9.5)
    return save_figure(figure, path)


#: Hidden ground of a map is drawn in the class colours mixed with this much white.
_HIDDEN_WHITE = 0.82


def _map_image(terrain: UInt8[np.ndarray, "h w"], seen: np.ndarray) -> Float[np.ndarray, "h w 3"]:
    """Class colours where observed, a pale version of them elsewhere."""
    colours = CLASS_COLORS[terrain] / 255.0
    pale = colours * (1 - _HIDDEN_WHITE) + _HIDDEN_WHITE
    return np.where(seen[..., None], colours, pale)


def _draw_robot(axes: Axes, frames: Frames, frame: int) -> None:
    """The path so far and the robot on its end."""
    x, y = frames.pose.x[: frame + 1], frames.pose.y[: frame + 1]
    axes.plot(x, y, color="white", linewidth=2.4, solid_joinstyle="round")
    axes.plot(x, y, color="black", linewidth=1.2, solid_joinstyle="round")
    axes.plot(x[:1], y[:1], "o", color="white", markeredgecolor="black", markersize=5)
    marker = ">v<^"[frames.pose.heading[frame]]
    axes.plot(x[-1:], y[-1:], marker, color="#f0e442", markeredgecolor="black", markersize=9)


def plain_axes(axes: Axes) -> None:
    """A grid behind the data, and no frame above and to the right."""
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def bare_axes(axes: Axes, title: str) -> None:
    """A title, and no ticks."""
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def plot_episode(
    path: str | Path, house: House, frames_by_planner: Mapping[str, Frames], columns: int = 4
) -> list[Path]:
    """Draw planners side by side from one start, as in Fig. 8: what each knew, and what it expected.

    One row a planner with the observed map over the pale hidden one, and a second row with the estimated cost-to-go for
    planners that make an estimate.

    Args:
      path: where to write, without an ending.
      house: the house.
      frames_by_planner: planner name -> its replayed episode, all from one start.
      columns: moments shown of each episode, from the first to the last.

    Returns:
      The files written: PNG and SVG.
    """
    rows = sum(1 + (frames.cost_to_go is not None) for frames in frames_by_planner.values())
    figure = Figure(figsize=(2.5 * columns + 0.9, 2.65 * rows + 0.5), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    row = 0
    for planner, frames in frames_by_planner.items():
        last = len(frames) - 1
        moments = np.linspace(0, last, columns).round().astype(int)
        for axes, frame in zip(grid[row], moments, strict=True):
            axes.imshow(_map_image(house.terrain, frames.seen[frame]), interpolation="nearest")
            _draw_robot(axes, frames, frame)
            bare_axes(axes, f"step {frame}" + (" (end)" if frame == last else ""))
        label = _STYLE[planner][0] if planner in _STYLE else planner
        grid[row][0].set_ylabel(f"{label}: {last} steps", fontsize=9)
        row += 1
        if frames.cost_to_go is None:
            continue
        road = TRAVERSABLE[house.terrain] & frames.seen[last]
        high = float(np.percentile(frames.cost_to_go[moments][:, road], 98))
        for axes, frame in zip(grid[row], moments, strict=True):
            known = frames.seen[frame] & TRAVERSABLE[house.terrain]
            image = axes.imshow(
                np.where(known, frames.cost_to_go[frame], np.nan),
                cmap="viridis_r",
                vmin=0,
                vmax=high,
                interpolation="nearest",
            )
            axes.set_facecolor("#eeeeee")
            bare_axes(axes, "")
        grid[row][0].set_ylabel("estimated cost-to-go", fontsize=9)
        figure.colorbar(image, ax=list(grid[row]), label="cells", shrink=0.9, pad=0.01)
        row += 1
    present = [index for index in np.unique(house.terrain) if index]
    patches = [
        Patch(facecolor=CLASS_COLORS[index] / 255.0, label=CLASS_NAMES[index].replace("_", " ")) for index in present
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), frameon=False, fontsize=8)
    return save_figure(figure, path)
