"""The figure: who is how fast, and on what it depends."""

from collections.abc import Callable, Sequence
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


def _bars(axes: Axes, rows: Sequence[Row], title: str, label: str, name: Callable[[Row], str] = _name) -> None:
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
    axes: Axes, groups: dict[str, Sequence[Row]], x: Callable[[Row], Any], title: str, labels: tuple[str, str]
) -> None:
    """A line a program, with the slowest repeat as the lower end of a bar."""
    for place, (name, rows) in enumerate(groups.items()):
        known = sorted((row for row in rows if row.rate and row.worst_rate), key=x)
        if not known:
            continue
        rates = [row.rate or 0.0 for row in known]
        below = [(row.rate or 0.0) - (row.worst_rate or 0.0) for row in known]
        axes.errorbar(
            [x(row) for row in known],
            rates,
            yerr=[below, [0.0] * len(known)],
            label=name,
            color=_COLORS[place % len(_COLORS)],
            marker=_MARKERS[place % len(_MARKERS)],
            markersize=4.5,
            linewidth=1.4,
            capsize=2,
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({x(row) for rows in groups.values() for row in rows if row.rate})
    axes.set_xticks(ticks, [f"{tick:,}" for tick in ticks], fontsize=7.5, rotation=30 if len(ticks) > 6 else 0)
    axes.xaxis.set_minor_locator(NullLocator())
    bottom, top = axes.get_ylim()
    crowded = len(groups) > 5
    axes.set_ylim(bottom, top * 12 if crowded else top)  # room for the legend
    _ticks(axes.yaxis, (bottom, top))
    _plain(axes, title)
    axes.set_xlabel(labels[0], fontsize=9)
    axes.set_ylabel(labels[1], fontsize=9)
    if axes.get_legend_handles_labels()[0]:
        where: dict[str, Any] = {"loc": "upper left", "ncols": 2} if crowded else {}
        axes.legend(fontsize=7.5, frameon=False, **where)


def _grouped(rows: Sequence[Row], name: Callable[[Row], str]) -> dict[str, Sequence[Row]]:
    groups: dict[str, Sequence[Row]] = {}
    for row in rows:
        groups[name(row)] = [*groups.get(name(row), ()), row]
    return groups


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
    others = [row for row in of("batch") if row.by != "dc2g_jax"]
    steps = "planner steps per second"
    panels: list[tuple[list[Row], Callable[[Axes, list[Row]], None]]] = [
        (
            of("planners", "frontier", "frontier_lazy"),
            lambda axes, own: _bars(axes, own, "Frontier exploration, whole episodes", steps),
        ),
        (
            of("planners"),
            lambda axes, own: _bars(
                axes,
                [row for row in own if row.by == "dc2g_jax"],
                "This package, by planner",
                steps,
                lambda row: _name(row).replace("dc2g_jax", row.what),
            ),
        ),
        (
            of("environment"),
            lambda axes, own: _bars(axes, own, "Environment alone, random actions", "steps per second"),
        ),
        (
            batch,
            lambda axes, own: _lines(
                axes,
                _grouped(own, lambda row: row.what),
                lambda row: row.batch,
                "By batch: this package",
                ("robots, environments or maps side by side", "steps or maps per second"),
            ),
        ),
        (
            [*[row for row in batch if row.what.startswith("environment")], *others],
            lambda axes, own: _lines(
                axes,
                _grouped(own, lambda row: row.by),
                lambda row: row.batch,
                "By batch: environments",
                ("environments side by side", "environment steps per second"),
            ),
        ),
        (
            of("grid"),
            lambda axes, own: _lines(
                axes,
                _grouped(own, _name),
                lambda row: row.cells,
                "By size of the map: frontier, 100 actions",
                ("side of the map (cells)", steps),
            ),
        ),
        (
            of("range"),
            lambda axes, own: _lines(
                axes,
                _grouped(own, _name),
                lambda row: row.sensing_range,
                "By sensing range: frontier, 100 actions",
                ("sensing range (cells)", steps),
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
