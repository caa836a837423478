"""The report: a table on the screen and in Markdown, everything in JSON."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dc2g_jax._src.files.atomic import write_json

from .machine import Peak
from .rows import Row

#: Section -> heading.
SECTIONS = {
    "planners": "Whole episodes",
    "environment": "Environment steps alone",
    "kernels": "Kernels alone",
    "network": "The network alone",
    "training": "Training: runs of 2,000 steps an hour",
    "batch": "By batch",
    "grid": "By size of the map",
    "golden": "The same episodes as on the CPU",
    "fig7": "Fig. 7",
    "translator": "Steps of the paper's translator",
    "searches": "Searches for objects indoors",
}
_COLUMNS = ("what", "by", "cores", "batch", "cells", "range", "a second", "worst", "median", "share", "more")


def in_short(value: float | None) -> str:
    """A number with three significant digits."""
    if value is None:
        return ""
    if value >= 1e6:
        return f"{value / 1e6:.3g} M"
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _seconds(value: float | None) -> str:
    if value is None:
        return ""
    scale, unit = (1.0, "s") if value >= 1 else (1e-3, "ms") if value >= 1e-3 else (1e-6, "us")
    return f"{value / scale:.3g} {unit}"


def cells_of(row: Row) -> list[str]:
    """A row as the table has it."""
    shares = ", ".join(f"{100 * share:.3g} % {resource}" for resource, share in row.shares.items())
    if row.missing is not None:
        more = row.missing
    else:
        agreements = ("same actions", "same answer")
        facts = [f"{name} {in_short(value)}" for name, value in row.facts.items() if name not in agreements]
        facts += [
            "same answer" if row.facts[name] == 1.0 else "ANOTHER ANSWER" for name in agreements if name in row.facts
        ]
        if row.added_memory is not None and row.added_memory >= 2**20:
            facts.append(f"{row.added_memory / 2**20:,.0f} MiB more memory")
        more = ", ".join(facts)
    rate = "" if row.rate is None else f"{in_short(row.rate)} {row.unit}"
    numbers = ["" if value is None else str(value) for value in (row.cores, row.batch, row.cells, row.sensing_range)]
    return [row.what, row.by, *numbers, rate, in_short(row.worst_rate), _seconds(row.seconds), shares, more]


def line_of(row: Row) -> str:
    """A row as it is told while the benchmark goes on."""
    return " | ".join(cell for cell in cells_of(row) if cell)


def _tables(rows: Sequence[Row]) -> dict[str, list[list[str]]]:
    """By heading, the rows of a section as text, without columns that stay empty."""
    tables = {}
    for section, heading in SECTIONS.items():
        if texts := [cells_of(row) for row in rows if row.section == section]:
            used = [column for column in range(len(_COLUMNS)) if any(text[column] for text in texts)]
            tables[heading] = [[text[column] for column in used] for text in [list(_COLUMNS), *texts]]
    return tables


def _markdown(table: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in table]
    return [lines[0], "|" + "---|" * len(table[0]), *lines[1:]]


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]


def text(rows: Sequence[Row]) -> str:
    """The table for the screen."""
    return "\n".join("\n".join([heading, *_aligned(table), ""]) for heading, table in _tables(rows).items())


def peak_lines(peaks: Mapping[str, Peak]) -> list[str]:
    """What the machine does at best, a line a resource."""
    return [
        f"measured {resource}: {in_short(peak.rate / 1e9)} G {peak.unit}, worst {in_short(peak.worst_rate / 1e9)}"
        for resource, peak in peaks.items()
    ]


def write(
    folder: Path, name: str, facts: Mapping[str, Any], peaks: Mapping[str, Peak], rows: Sequence[Row]
) -> list[Path]:
    """Write `NAME.json` and `NAME.md`."""
    told = {resource: dataclasses.asdict(peak) for resource, peak in peaks.items()}
    data = {**facts, "peaks": told, "rows": [dataclasses.asdict(row) for row in rows]}
    write_json(folder / f"{name}.json", data)
    machine = [f"- {name}: {value}" for name, value in facts["machine"].items()]
    lines = ["# Benchmark", "", *machine, *(f"- {line}" for line in peak_lines(peaks)), ""]
    lines += [facts["about"], ""]
    for heading, table in _tables(rows).items():
        lines += [f"## {heading}", "", *_markdown(table), ""]
    (folder / f"{name}.md").write_text("\n".join(lines))
    return [folder / f"{name}.json", folder / f"{name}.md"]
