"""Figures for publication as PNG, SVG and PDF, readable in grayscale and with color blindness."""

import itertools
import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import ColorType

from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_COLORS, FIGURE_RGB
from dc2g_jax._src.planning.named import PLANNERS
from dc2g_jax._src.rollouts.leaderboard import PRIVILEGED, Families, in_order
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.errors import InputError

#: Width of figures, inches: the two columns of a page, so that text has its final size.
PAGE_WIDTH = 7.16


class PlannerStyle(NamedTuple):
    """Style of a planner in all figures.

    Attributes:
      label: name in legends.
      color: a color of Okabe and Ito.
      hatch: hatch of bars.
      marker: marker of points.
    """

    label: str
    color: str
    hatch: str = ""
    marker: str = "o"


#: The styles of planners by name, in the order in which figures show them.
PLANNER_STYLES = {
    "oracle": PlannerStyle("Oracle", "#333333", marker="*"),
    "authors_frontier": PlannerStyle("Frontier, authors' code", "#f5c99b", hatch="///"),
    "frontier": PlannerStyle("Frontier", "#d55e00", marker="s"),
    "authors_dc2g": PlannerStyle("DC2G, authors' network", "#a9d3ee", hatch="///"),
    "dc2g_paper": PlannerStyle("DC2G, Algorithm 2", "#f0e442", hatch="\\\\\\", marker="v"),
    "dc2g": PlannerStyle("DC2G", "#0072b2"),
    "dc2g_uncertain": PlannerStyle("DC2G, averse to risk", "#cc79a7", hatch="...", marker="D"),
    "dc2g_bounded": PlannerStyle("DC2G, bounded", "#56b4e9", hatch="---", marker="p"),
    "true_cost_to_go": PlannerStyle("DC2G, exact cost-to-go", "#009e73", hatch="xxx", marker="^"),
}

#: Colors of other planners, none of them near one above.
SPARE_COLORS = ("#332288", "#999933", "#882255", "#8c564b", "#e7298a", "#66cc33", "#7f6fff", "#00ced1")

#: Hatches and markers of other planners. One color has another of them each time that it is used.
_OTHER_HATCHES = ("", "\\\\\\", "...", "+++", "ooo")
_OTHER_MARKERS = ("P", "X", "v", "h", "<", "p", ">")

#: Ground that has not been observed is drawn in the class colors mixed with this much white.
_HIDDEN_WHITE = 0.85

GROUP_LABELS = {
    "train": "training\nhouses",
    "val": "validation\nhouses",
    "same_neighborhood": "same\nneighborhood",
    "new_neighborhood": "new\nneighborhood",
    "urban": "urban",
    "all": "all",
    "test": "all test\nhouses",
}


def planner_styles(planners: Iterable[str]) -> dict[str, PlannerStyle]:
    """Styles of planners, in the order of `PLANNER_STYLES`, other planners last.

    Another planner looks the same in all figures, unless one before it has taken its color.
    """
    present = dict.fromkeys(planners)
    styles = {name: style for name, style in PLANNER_STYLES.items() if name in present}
    others = sorted((name for name in present if name not in styles), key=PLANNERS.__contains__)  # users' own first
    for n, name in enumerate(others):
        turn, free = divmod(n, len(SPARE_COLORS))
        if free == 0:
            left = list(range(len(SPARE_COLORS)))
        wanted = zlib.crc32(name.encode()) % len(SPARE_COLORS)
        look = min(left, key=lambda look: (look - wanted) % len(SPARE_COLORS))
        left.remove(look)
        hatch, marker = (looks[(look + turn) % len(looks)] for looks in (_OTHER_HATCHES, _OTHER_MARKERS))
        styles[name] = PlannerStyle(name.rpartition(":")[2], SPARE_COLORS[look], hatch, marker)  # without its module
    return styles


def save_figure(figure: Figure, path: str | Path, dpi: int = 160) -> list[Path]:
    """Write a figure as PNG with `dpi` pixels per inch, as SVG and as PDF; `path` is the file name without ending.

    Text stays text: it can be searched and edited. The PDF embeds its font (TrueType, as journals require). Viewers
    show the SVG in DejaVu Sans if they have it.
    """
    FigureCanvasAgg(figure)
    written = [Path(f"{path}{ending}") for ending in (".png", ".svg", ".pdf")]
    with matplotlib.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}):
        for target in written:
            figure.savefig(target, dpi=dpi)
    return written


#: Description of `scale_extra_steps` for captions.
SCALE_NOTE = "logarithmic beyond 10 %"


def scale_extra_steps(axes: Axes, direction: str, ends: tuple[float, float]) -> None:
    """Scale an axis linearly up to 10 % and logarithmically beyond, so that episodes without extra steps are shown."""
    ticks = [tick for tick in (0, 10, 30, 100, 300, 1000, 3000) if tick < ends[1]]
    getattr(axes, f"set_{direction}scale")("symlog", linthresh=10, linscale=0.6)
    getattr(axes, f"set_{direction}lim")(*ends)
    getattr(axes, f"set_{direction}ticks")(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()


#: Panels of a row, and range of the axis, of the figure of the leaderboard.
_PANELS_A_ROW, _RATIOS_SHOWN = 4, (0.25, 1.25)


def plot_leaderboard(path: str | Path, families: Families) -> None:
    """Draw steps relative to the reference, with a panel for each family, the best planner at the top.

    Means beyond the axis are triangles at its edge.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      families: the episodes.
    """
    planners = in_order(families)[::-1]
    rows = -(-len(families) // _PANELS_A_ROW)
    figure = Figure(figsize=(PAGE_WIDTH, rows * (0.5 + 0.17 * len(planners)) + 0.4), layout="constrained")
    columns = min(len(families), _PANELS_A_ROW)
    all_axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    low, high = _RATIOS_SHOWN
    own = planner_styles(name for name in planners if name not in PLANNERS)
    for axes in all_axes[len(families) :]:
        axes.set_axis_off()
    for axes, (name, family) in zip(all_axes, families.items(), strict=False):
        axes.axvline(1, color="#555555", linewidth=0.8)
        for row, planner in enumerate(planners):
            ratio = family.ratio(planner)
            color = "#888888" if planner in PRIVILEGED else "#0072b2" if planner == "dc2g" else "#d55e00"
            color = own[planner].color if planner in own else color
            axes.hlines(row, ratio.low, ratio.high, color=color, linewidth=1.6)
            shown = "<" if ratio.mean < low else ">" if ratio.mean > high else "o"
            axes.plot(np.clip(ratio.mean, low, high), row, shown, color=color, markersize=3.2, clip_on=False)
        axes.set_title(name, fontsize=7.5)
        plain_axes(axes, grid="both", label_size=6.5)
    all_axes[0].set_xscale("log")
    all_axes[0].set_xlim(low, high)
    ticks = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
    all_axes[0].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    all_axes[0].minorticks_off()
    for axes in all_axes[max(0, len(families) - columns) : len(families)]:  # no panel is below
        axes.tick_params(labelbottom=True)
    all_axes[0].set_yticks(range(len(planners)), [name.rpartition(":")[2] for name in planners])
    figure.supxlabel("steps relative to frontier exploration: geometric mean, 95 % interval over maps", fontsize=7.5)
    save_figure(figure, path, dpi=200)


def planner_style(name: str) -> PlannerStyle:
    """The style of a planner; a plain style for planners that are not in `PLANNER_STYLES`."""
    return planner_styles([name])[name]


def present_classes(terrain: UInt8[np.ndarray, "*cells"]) -> list[int]:
    """The classes of a map, the most frequent first."""
    cells = np.bincount(terrain.ravel(), minlength=len(CLASS_NAMES))
    return np.argsort(-cells, kind="stable")[: np.count_nonzero(cells)].tolist()


def map_image(terrain: UInt8[np.ndarray, "h w"], seen: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Class colors where observed, a pale version of them elsewhere; RGB from 0 to 1."""
    colors = FIGURE_RGB[terrain] / 255
    return np.where(seen[..., None], colors, colors * (1 - _HIDDEN_WHITE) + _HIDDEN_WHITE)


def legend_patch(label: str, color: ColorType) -> Patch:
    """The legend entry of a kind of cells on a map."""
    return Patch(facecolor=color, edgecolor="#777777", linewidth=0.4, label=label)


def class_patch(index: int, color: ColorType | None = None) -> Patch:
    """The legend entry of a class, in its color from `FIGURE_COLORS` or the given one."""
    label = CLASS_NAMES[index].replace("_", " ") if index else "unknown"
    return legend_patch(label, FIGURE_COLORS[CLASS_NAMES[index]] if color is None else color)


def plain_axes(axes: Axes, *, grid: Literal["both", "x", "y"] = "both", label_size: float = 8) -> None:
    """Draw a grid behind the data, and no frame above and on the right."""
    axes.grid(True, axis=grid, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=label_size)
    axes.spines[["top", "right"]].set_visible(False)


#: Heights in strip plots, inches: a planner's lane, the space between houses, and a group's headline.
_LANE, _BETWEEN, _HEADLINE = 0.075, 0.06, 0.2

#: Largest number of houses in a single column of strips.
_ONE_COLUMN = 20


def plot_results(
    results: Iterable[EpisodeResult], path: str | Path, group_by_house: Mapping[str, str] | None = None, title: str = ""
) -> list[Path]:
    """Draw the extra steps of every episode in the results of `dc2g_jax.evaluate`, with one strip per house.

    Episodes are points, in a lane for each planner with a bar at their mean.

    Args:
      results: episodes of any number of planners. Those of the oracle, or without a goal in reach, are left out.
      path: output path without ending.
      group_by_house: house -> group; houses are ordered by group and name. `None` for a single group.
      title: description of the episodes.

    Returns:
      The files written: PNG, SVG and PDF.

    Raises:
      InputError: none are left.
    """
    extra: dict[str, dict[str, list[float]]] = {}
    for result in results:
        if result.planner != "oracle" and result.extra is not None:
            extra.setdefault(result.house, {}).setdefault(result.planner, []).append(result.extra)
    if not extra:
        raise InputError("no planner to compare with the oracle: give episodes of another one as well")
    group_by_house = group_by_house or dict.fromkeys(extra, "houses")
    styles = planner_styles(planner for by_planner in extra.values() for planner in by_planner)
    houses = sorted(extra, key=lambda house: (group_place(group_by_house[house]), house))
    room = len(houses) if len(houses) <= _ONE_COLUMN else math.ceil(len(houses) / 2)
    pages = [houses[first : first + room] for first in range(0, len(houses), room)]
    house_height = _LANE * len(styles) + _BETWEEN
    heights = [_HEADLINE * len({group_by_house[house] for house in page}) + house_height * len(page) for page in pages]
    entries_a_row = 2 * len(pages)
    height = max(heights) + 0.85 + 0.15 * math.ceil(len(styles) / entries_a_row)
    figure = Figure(figsize=(PAGE_WIDTH / 2 * len(pages), height), layout="constrained")
    most = max(value for by_planner in extra.values() for values in by_planner.values() for value in values)
    columns = figure.subplots(1, len(pages), squeeze=False)[0]
    for axes, page in zip(columns, pages, strict=True):
        _draw_strips(axes, page, group_by_house, extra, styles)
        axes.set_ylim(max(heights), 0)
        scale_extra_steps(axes, "x", (-3.0, max(1.3 * most, 12.0)))
        axes.tick_params(axis="x", labelsize=7.5)
        axes.xaxis.grid(True, color="#cccccc", linewidth=0.5)
        axes.set_axisbelow(True)
        axes.spines[["top", "right", "left"]].set_visible(False)
    lines = [f"extra steps beyond the oracle (%), {SCALE_NOTE}", "bars: means"]
    figure.supxlabel(("\n" if len(pages) == 1 else "; ").join(lines), fontsize=8.5)
    handles = [
        Line2D([], [], linestyle="none", marker=style.marker, color=style.color, markersize=5, label=style.label)
        for style in styles.values()
    ]
    figure.legend(
        handles=handles, title=title, title_fontsize=8.5, loc="outside upper center",
        ncols=entries_a_row, frameon=False, fontsize=8.5,
    )  # fmt: skip
    return save_figure(figure, path, dpi=300)


def group_place(group: str) -> tuple[int, str]:
    """Sort key of a group."""
    order = list(GROUP_LABELS)
    return (order.index(group) if group in order else len(order)), group


def _draw_strips(
    axes: Axes,
    page: Sequence[str],
    group_by_house: Mapping[str, str],
    extra: Mapping[str, Mapping[str, Sequence[float]]],
    styles: Mapping[str, PlannerStyle],
) -> None:
    """Draw one column of strips, from the top down in inches."""
    names: list[tuple[float, str]] = []
    y, lanes = 0.0, _LANE * len(styles)
    for group, houses in itertools.groupby(page, key=lambda house: group_by_house[house]):
        label = GROUP_LABELS.get(group, group).replace("\n", " ")
        axes.annotate(
            label, (0, y + 0.75 * _HEADLINE), xycoords=("axes fraction", "data"), fontsize=8, fontweight="bold"
        )
        y += _HEADLINE
        for number, house in enumerate(houses):
            if number % 2 == 0:
                axes.axhspan(y, y + lanes + _BETWEEN, color="#f1f1f1", linewidth=0)
            names.append((y + (lanes + _BETWEEN) / 2, house))
            for lane, (planner, style) in enumerate(styles.items()):
                values = extra[house].get(planner, [])
                middle = y + _BETWEEN / 2 + _LANE * (lane + 0.5)
                axes.plot(
                    values, [middle] * len(values), style.marker, color=style.color, markersize=3, alpha=0.55,
                    markeredgewidth=0, clip_on=False,
                )  # fmt: skip
                if values:
                    ends = (middle - 0.55 * _LANE, middle + 0.55 * _LANE)
                    axes.vlines(float(np.mean(values)), *ends, color="black", linewidth=2.0)
                    axes.vlines(float(np.mean(values)), *ends, color=style.color, linewidth=1.0)
            y += lanes + _BETWEEN
    axes.set_yticks([place for place, _ in names], [name for _, name in names], fontsize=7)
    axes.tick_params(axis="y", length=0)
