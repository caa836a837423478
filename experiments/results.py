"""Write the figures of README, BENCHMARKS and docs from one file: `python -m experiments.results`.

`docs/results.json` holds what commands wrote, without what no page shows, by a name for each run. `results.txt` holds
the rows and sentences of pages that show them, with fields. A test fails where a page shows another figure.
"""

import dataclasses
import json
import re
import statistics
import string
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.outputs import RUN_FILE, CommandOptions
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.rollouts.statistics import Mean
from dc2g_jax._src.runtime.errors import InputError

from .benchmarks.report import in_short
from .support.searches import with_interval

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results.json"
#: What commands write and no page shows.
_LEFT_OUT = {"about", "checksum", "facts", "first_seconds", "note", "oracle", "peak_memory", "peaks", "seconds", "unit"}
_NUMBER = r"[+-]?\d(?:[\d.,-]*\d)?(?: M\b| million)?"


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Write the figures of `docs/results.json` into the pages.

    Attributes:
      take: a name in that file, and the output folder of a run whose figures are to replace those of this name.
    """

    take: tuple[str, Path] | None = None


def _short(value: Any) -> Any:
    """A part of a command's JSON, without what no page shows."""
    if isinstance(value, Mapping):
        return {key: _short(part) for key, part in value.items() if key not in _LEFT_OUT and part not in (None, {}, [])}
    if isinstance(value, list):
        return [_short(part) for part in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def run_in(folder: Path) -> dict[str, Any]:
    """What an output folder says of its last run: command, date, commit, versions and figures."""
    run = read_object(folder / RUN_FILE, "give the output folder of a command")["runs"][-1]
    command = re.sub(r"(?<= )/\S+", "FOLDER", re.sub(r" --(out \S+|resume)\b", "", run["command"]))
    facts = {"command": command, "date": run["began"][:10], "commit": run["commit"]}
    for path in sorted(set(folder.glob("*.json")) - {folder / RUN_FILE}):
        facts |= _short(json.loads(path.read_text()))
    return facts | {"versions": run["versions"]}


def _names(results: Mapping[str, Any]) -> dict[str, Any]:
    """What fields can name: the runs, and what is computed from them."""

    def rows(run: str, *columns: str) -> dict[str, Any]:
        return {" ".join(str(row.get(column)) for column in columns): row for row in results[run]["rows"]}

    def means(runs: str, settings: str, group: str) -> list[float]:
        several = [run for name, run in results.items() if name == "fig7" or name.startswith(f"fig7 {runs}")]
        return [run[settings]["dc2g"][group]["mean_extra"] for run in several]

    def waits(planner: str, cells: int) -> list[str]:
        repeats = [row for row in results[f"latency {planner}"]["rows"] if row["cells"] == cells]
        columns = ([row[column] for row in repeats] for column in ("p50", "p99", "worst", "first"))
        return [f"{min(times):#.2g} to {max(times):#.2g}" for times in columns]

    def gain(agents: Mapping[str, Any], name: str) -> dict[str, Any]:
        one, least, most = agents[name], agents["random"], agents["true_cost"]
        more = {key: one[key] - least[key] for key in ("success", "spl", "distance", "steps")}
        share = [more[key] / (most[key] - least[key]) for key in ("success", "spl")]
        path = [a / b - 1 for key in ("acceleration", "jerk") for a, b in zip(one[key], least[key], strict=True)]
        return more | {"nearer": -more["distance"], "share": share, "path": path}

    agents, paper = results["table1"]["agents"], results["table1"]["paper"]
    ours = {name: one | {key: one[key][0] for key in ("success", "spl")} for name, one in agents.items()}
    ahead = results["head-to-head"]["groups"]["all"]
    return {
        **results,
        **{settings: results["fig7"][settings] for settings in ("published", "paper")},
        "starts": means("starts", "paper", "test"),
        "ahead": ahead,
        "alone": results["head-to-head dc2g_paper"]["groups"]["all"],
        "less": [-ahead["difference"], *(-bound for bound in reversed(ahead["difference_interval"]))],
        "searches": {"ours": ours, "paper": paper, "intervals": agents},
        "gain": {"paper": gain(paper, "predicted"), "down": gain(ours, "predicted"), "best": gain(ours, "promising")},
        "speed": rows("planners", "what", "by", "cores"),
        "sides": rows("grid", "what", "by", "cells"),
        "robots": rows("H200", "what", "batch"),
        "runs": rows("training", "what") | rows("H200", "what"),
        "waits": {f"{name} {cells}": waits(name, cells) for name in ("dc2g", "frontier") for cells in (50, 100)},
    }


def _search(one: Mapping[str, Any], mean: Callable[[Any], str]) -> str:
    means = f"{mean(one['success'])} | {mean(one['spl'])} | {one['distance']:.2f} | {one['steps']:.1f}"
    return " | ".join([means, *(f"{one[key][0]:.2f}, {one[key][1]:.2f}" for key in ("acceleration", "jerk"))])


#: How fields show figures, beside Python's own forms.
_FORMS: dict[str, Callable[[Any], str]] = {
    "cells": " | ".join,
    "change": lambda mean: with_interval(Mean(*mean), "+"),
    "extra": lambda one: f"{one['mean_extra']:.1f} ({one['median_extra']:.1f})",
    "extras": lambda groups: " | ".join(map(_FORMS["extra"], groups.values())),
    "interval": lambda one: f"{one['mean_low']:.1f} to {one['mean_high']:.1f}",
    "mean": lambda numbers: f"{statistics.mean(numbers):.1f}",
    "million": lambda row: in_short(row["rate"]).replace(" M", " million"),
    "percent": lambda share: f"{100 * share:.0f} %",
    "rate": lambda row: f"{in_short(row['rate'])} ({in_short(row['worst_rate'])})",
    "search": lambda one: _search(one, "{:.3f}".format),
    "searches": lambda one: f"{_search(one, lambda mean: with_interval(Mean(*mean)))} | {one['collisions']:.1f}",
    "short": lambda row: in_short(row["rate"]),
    "success": lambda one: f"{100 * one['success']:.2f} %",
}


def templates() -> dict[str, list[str]]:
    """By page, its rows and sentences with fields for the figures."""
    pages = Path(__file__).with_suffix(".txt").read_text().split("@ ")[1:]
    return {page: lines for page, *lines in map(str.splitlines, pages)}


def with_figures(text: str, page: str, results: Mapping[str, Any]) -> str:
    """The text of a page with the figures of the results.

    Raises:
      InputError: the page does not have each of its rows and sentences once.
    """
    names, formatter = _names(results), string.Formatter()
    for template in templates()[page]:
        pattern, figures = "", []
        for words, field, form, _ in formatter.parse(template):
            pattern += re.escape(words)
            if field is not None:
                value = formatter.get_field(field, (), names)[0]
                figures.append(_FORMS[form](value) if form in _FORMS else format(value, form or ""))
                pattern += f"({_NUMBER.join(map(re.escape, re.split(_NUMBER, figures[-1])))})"
        # Sentences may be wrapped; a row may begin like one with more figures.
        found = list(re.finditer(pattern.replace(r"\ ", r"\s+") + r"(?!(?<=\|) [-+\d])", text))
        if len(found) != 1:
            raise InputError(f"{page}: {len(found)} places, not one, are like this line of results.txt: {template}")
        for group, figure in reversed([*enumerate(figures, start=1)]):
            if found[0][group].split() != figure.split():
                text = text[: found[0].start(group)] + figure + text[found[0].end(group) :]
    return text


def write(results: Mapping[str, Any]) -> None:
    """Write the file of results, innermost objects on one line each."""
    text = json.dumps(results, indent=1, ensure_ascii=False)
    RESULTS.write_text(re.sub(r"\{[^{}]*\}", lambda part: " ".join(part[0].split()), text) + "\n")


def main(options: Options) -> None:
    """Take a run's figures, if one is given, and write all into the pages."""
    results = json.loads(RESULTS.read_text())
    if options.take is not None:
        name, folder = options.take
        if name not in results:
            raise InputError(f"--take {name}: {RESULTS.name} has {', '.join(results)}; write a new name into it first")
        results[name] = run_in(folder)
    try:
        pages = {page: with_figures((ROOT / page).read_text(), page, results) for page in templates()}
    except KeyError as error:
        raise InputError(f"{RESULTS.name}: pages show {error}, which a run there lacks; take another run") from None
    write(results)
    for page, text in pages.items():
        (ROOT / page).write_text(text)


if __name__ == "__main__":
    command_line(Options, main)
