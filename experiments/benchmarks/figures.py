"""The figure: who is how fast, and on what it depends."""

import collections
import operator
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullLocator

from .rows import Row

#: Colors of Okabe and Ito.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#666666", "#000000")
_MARKERS = "osD^vPX*"

#: What most panels show.
_STEPS = "planner steps per second"


def _plain(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=10.5, loc="left")
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _ticks(axis: Axis, values: Sequence[float]) -> None:
    """Ticks of a logarithmic axis: powers of ten, and 2 and 5 between them where there are few."""
    few = max(values) < 50 * min(values)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(EngFormatter(sep=" "))
    axis.set_tick_params(labelsize=8)


def _name(row: Row) -> str:
    cores = "" if row.cores is None else f", {row.cores} core" + "s" * (row.cores > 1)
    how = ", lazy" if row.what.endswith("_lazy") else ""
    return f"{row.by}{how}{cores}"


def _bars(
    axes: Axes, rows: Sequence[Row], *, title: str, label: str = _STEPS, name: Callable[[Row], str] = _name
) -> None:
    """A bar a program, the fastest on top."""
    rows = sorted((row for row in rows if row.rate), key=lambda row: row.rate or 0.0)
    for place, row in enumerate(rows):
        assert row.rate is not None
        own = row.by == "dc2g_jax"
        axes.barh(place, row.rate, color=_COLORS[0] if own else "#bbbbbb", edgecolor="#333333", linewidth=0.5)
        axes.annotate(
            f"{row.rate:,.0f}", (row.rate, place), xytext=(3, 0), textcoords="offset points", va="center", fontsize=7.5
        )
    axes.set_yticks(range(len(rows)), [name(row) for row in rows], fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim((rows[0].rate or 1.0) / 3, (rows[-1].rate or 1.0) * 6)
    _ticks(axes.xaxis, axes.get_xlim())
    _plain(axes, title)
    axes.grid(False, axis="y")
    axes.set_xlabel(label, fontsize=9)


def _lines(
    axes: Axes,
    rows: Sequence[Row],
    *,
    title: str,
    x: tuple[str, str],
    label: str = _STEPS,
    name: Callable[[Row], str] = _name,
) -> None:
    """A line a program, over an attribute with its label, with the slowest repeat as the lower end of a bar."""
    place_of, groups = operator.attrgetter(x[0]), collections.defaultdict[str, list[Row]](list)
    for row in rows:
        groups[name(row)].append(row)
    for place, (program, own) in enumerate(groups.items()):
        known = sorted((row for row in own if row.rate and row.worst_rate), key=place_of)
        if not known:
            continue
        rates = [row.rate or 0.0 for row in known]
        below = [(row.rate or 0.0) - (row.worst_rate or 0.0) for row in known]
        axes.errorbar(
            [place_of(row) for row in known],
            rates,
            yerr=[below, [0.0] * len(known)],
            label=program,
            color=_COLORS[place % len(_COLORS)],
            marker=_MARKERS[place % len(_MARKERS)],
            markersize=4.5,
            linewidth=1.4,
            capsize=2,
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({place_of(row) for row in rows if row.rate})
    axes.set_xticks(ticks, [f"{tick:,}" for tick in ticks], fontsize=7.5, rotation=30 if len(ticks) > 6 else 0)
    axes.xaxis.set_minor_locator(NullLocator())
    bottom, top = axes.get_ylim()
    crowded = len(groups) > 5
    axes.set_ylim(bottom, top * 12 if crowded else top)  # room for the legend
    _ticks(axes.yaxis, (bottom, top))
    _plain(axes, title)
    axes.set_xlabel(x[1], fontsize=9)
    axes.set_ylabel(label, fontsize=9)
    if axes.get_legend_handles_labels()[0]:
        where: dict[str, Any] = {"loc": "upper left", "ncols": 2} if crowded else {}
        axes.legend(fontsize=7.5, frameon=False, **where)


def _shares(axes: Axes, rows: Sequence[Row]) -> None:
    """What part of the machine each kernel reaches."""
    rows = [row for row in rows if row.shares][::-1]
    resources = list(dict.fromkeys(resource for row in rows for resource in row.shares))
    height = 0.8 / max(1, len(resources))
    for offset, resource in enumerate(resources):
        shown = [(place, row.shares[resource]) for place, row in enumerate(rows) if resource in row.shares]
        axes.barh(
            [place + (offset - (len(resources) - 1) / 2) * height for place, _ in shown],
            [100 * share for _, share in shown],
            height,
            label=resource,
            color=_COLORS[offset],
            edgecolor="#333333",
            linewidth=0.5,
        )
    names = [row.what + (f", batch {row.batch}" if row.what == "network" else "") for row in rows]
    axes.set_yticks(range(len(rows)), names, fontsize=8)
    _plain(axes, "Share of what the machine can do")
    axes.grid(False, axis="y")
    axes.set_xlabel("percent of measured peak (beyond 100 %: in the caches)", fontsize=9)
    if resources:
        axes.legend(fontsize=7.5, frameon=False, loc="lower right")


def plot(path: str | Path, facts: dict[str, Any], rows: Sequence[Row]) -> list[Path]:
    """Draw the panels for which there are rows.

    Args:
      path: where to write, without an ending.
      facts: `machine`, `dataset`, `episodes` and `repeats` are told in the caption.
      rows: the report.

    Returns:
      The PNG.
    """

    def of(section: str, *whats: str) -> list[Row]:
        return [row for row in rows if row.section == section and (not whats or row.what in whats)]

    batch = [row for row in of("batch") if row.by == "dc2g_jax"]
    environments = [row for row in of("batch") if row.by != "dc2g_jax" or row.what.startswith("environment")]
    mine = [row for row in of("planners") if row.by == "dc2g_jax"]
    panels: list[tuple[list[Row], Callable[[Axes, list[Row]], None]]] = [
        (of("planners", "frontier", "frontier_lazy"), partial(_bars, title="Frontier exploration, whole episodes")),
        (
            mine,
            partial(_bars, title="This package, by planner", name=lambda row: _name(row).replace("dc2g_jax", row.what)),
        ),
        (of("environment"), partial(_bars, title="Environment alone, random actions", label="steps per second")),
        (
            batch,
            partial(
                _lines,
                title="By batch: this package",
                x=("batch", "robots, environments or maps side by side"),
                label="steps or maps per second",
                name=lambda row: row.what,
            ),
        ),
        (
            environments,
            partial(
                _lines,
                title="By batch: environments",
                x=("batch", "environments side by side"),
                label="environment steps per second",
                name=lambda row: row.by,
            ),
        ),
        (
            of("grid"),
            partial(_lines, title="By size of the map: frontier, 100 actions", x=("cells", "side of the map (cells)")),
        ),
        (
            of("range"),
            partial(
                _lines, title="By sensing range: frontier, 100 actions", x=("sensing_range", "sensing range (cells)")
            ),
        ),
        ([*of("kernels"), *of("network")], _shares),
    ]
    shown = [(own, draw) for own, draw in panels if any(row.rate for row in own)]
    columns = min(2, max(1, len(shown)))
    lines = max(1, -(-len(shown) // columns))
    figure = Figure(figsize=(6.4 * columns, 3.7 * lines + 0.6), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False).flatten()
    for axes, (own, draw) in zip(grid, shown, strict=False):
        draw(axes, own)
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    machine = facts["machine"]
    device = ", ".join(machine["accelerators"]) or f"{machine['cpu']}, {machine['cores']} cores"
    figure.suptitle(f"dc2g_jax on {device} (jax {machine['jax']})", fontsize=12)
    figure.supxlabel(
        f"{facts['episodes']} episodes in {facts['houses']} houses of {facts['dataset']}; median of {facts['repeats']} "
        "repeats, bars down to the worst; compilation apart." + (" QUICK RUN." if facts["quick"] else ""),
        fontsize=8,
        color="#555555",
    )
    FigureCanvasAgg(figure)
    target = Path(path).with_suffix(".png")
    figure.savefig(target, dpi=150)
    return [target]
