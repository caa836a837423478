"""Write the figures of README, BENCHMARKS and docs from one file: `python -m experiments.results`.

`docs/results.json` holds what commands wrote, without what no page shows, by a name for each run. `results.txt` holds
the passages of pages that show it, with fields for the figures. A test fails where a page shows another figure.
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
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.files.reading import read_object
from dc2g_jax._src.search_indoors.search.evaluation import with_interval

from .benchmarks.report import short_number

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results.json"
#: What commands write and no page shows.
_LEFT_OUT = set(
    "about added_memory checksum dataset facts first_seconds houses houses_where_frontier_is_shorter note oracle "
    "peak_memory peaks planner quick resamples seconds seed sensing_range source split unit".split()
)
#: A figure as `_shown` makes it, on one line or two.
_FIGURE = r"((?:[-+\d.,()|\s]|to|M|million)+?)"


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
    facts = {"command": re.sub(r" --out \S+", "", run["command"]), "date": run["began"][:10], "commit": run["commit"]}
    for path in sorted(set(folder.glob("*.json")) - {folder / RUN_FILE}):
        facts |= _short(json.loads(path.read_text()))
    return facts | {"versions": run["versions"]}


def _names(results: Mapping[str, Any]) -> dict[str, Any]:
    """What fields can name: the runs, and what is computed from them."""

    def rows(run: str, *columns: str) -> dict[str, Any]:
        return {" ".join(str(row.get(column)) for column in columns): row for row in results[run]["rows"]}

    def means(runs: str, settings: str, group: str) -> list[float]:
        several = [run for name, run in results.items() if name == "fig7" or name.startswith(f"fig7, {runs}")]
        return [run[settings]["dc2g"][group]["mean_extra"] for run in several]

    def gain(agents: Mapping[str, Any], name: str) -> dict[str, Any]:
        one, least, most = agents[name], agents["random"], agents["true_cost"]
        more = {key: one[key] - least[key] for key in ("success", "spl", "distance", "steps")}
        share = [more[key] / (most[key] - least[key]) for key in ("success", "spl")]
        path = [a / b - 1 for key in ("acceleration", "jerk") for a, b in zip(one[key], least[key], strict=True)]
        return more | {"nearer": -more["distance"], "share": share, "path": path}

    intervals, theirs = results["table1"]["agents"], results["table1"]["paper"]
    ours = {name: one | {key: one[key][0] for key in ("success", "spl")} for name, one in intervals.items()}
    ahead = results["head-to-head"]["groups"]["all"]
    return {
        **results,
        "published": results["fig7"]["published"],
        "paper": results["fig7"]["paper"],
        "starts": means("starts", "paper", "test"),
        "trainings": [means("training", "published", "all"), means("training", "paper", "test")],
        "ahead": ahead,
        "alone": results["head-to-head, dc2g_paper"]["groups"]["all"],
        "less": [-ahead["difference"], *(-bound for bound in reversed(ahead["difference_interval"]))],
        "searches": {"ours": ours, "paper": theirs, "intervals": intervals},
        "gain": {"paper": gain(theirs, "predicted"), "down": gain(ours, "predicted"), "best": gain(ours, "promising")},
        "speed": rows("planners", "what", "by", "cores"),
        "sides": rows("grid", "what", "by", "cells"),
        "robots": rows("H200", "what", "batch"),
        "runs": rows("training", "what") | rows("H200", "what"),
    }


def _waits(run: Mapping[str, Any], cells: int) -> list[str]:
    """Median, 99 %, worst and first wait of a latency run in maps of a size: the lowest and highest of its repeats."""
    repeats = [row for row in run["rows"] if row["cells"] == cells]
    columns = ([row[column] for row in repeats] for column in ("p50", "p99", "worst", "first"))
    return [f"{min(times):#.2g} to {max(times):#.2g}" for times in columns]


def _searches(one: Mapping[str, Any], mean: Callable[[Any], str]) -> str:
    pairs = (", ".join(f"{number:.2f}" for number in one[key]) for key in ("acceleration", "jerk"))
    return " | ".join([*map(mean, (one["success"], one["spl"])), f"{one['distance']:.2f}", f"{one['steps']:.1f}", *pairs])


#: How fields show figures, beside Python's own forms.
_FORMS: dict[str, Callable[[Any], str]] = {
    "extra": lambda one: f"{one['mean_extra']:.1f} ({one['median_extra']:.1f})",
    "extras": lambda groups: " | ".join(map(_FORMS["extra"], groups.values())),
    "interval": lambda one: f"{one['mean_low']:.1f} to {one['mean_high']:.1f}",
    "percent": lambda share: f"{100 * share:.0f}",
    "door": lambda one: f"{100 * one['success']:.2f}",
    "mean": lambda numbers: f"{statistics.mean(numbers):.1f}",
    "deviation": lambda numbers: f"{statistics.stdev(numbers):.1f}",
    "rate": lambda row: f"{short_number(row['rate'])} ({short_number(row['worst_rate'])})",
    "short": lambda row: short_number(row["rate"]),
    "million": lambda row: short_number(row["rate"]).replace(" M", " million"),
    "wait": lambda run: _waits(run, 50)[0],
    "waits_50": lambda run: " | ".join(_waits(run, 50)),
    "waits_100": lambda run: " | ".join(_waits(run, 100)),
    "search": lambda one: _searches(one, "{:.3f}".format),
    "searches": lambda one: f"{_searches(one, with_interval)} | {one['collisions']:.1f}",
    "change": lambda mean: with_interval(mean, "+"),
}


def with_figures(text: str, page: str, results: Mapping[str, Any]) -> str:
    """The text of a page with the figures of the results.

    Raises:
      InputError: the page does not have each of its passages once.
    """
    formatter, names = string.Formatter(), _names(results)
    for passage in passages()[page]:
        pattern, figures = "", []
        for words, field, form, _ in formatter.parse(passage):
            pattern += re.escape(words).replace(r"\ ", r"\s+")
            if field is not None:
                value = formatter.get_field(field, (), names)[0]
                figures.append(_FORMS[form](value) if form in _FORMS else format(value, form or ""))
                pattern += _FIGURE
        pattern += r"\n" if "|---|" in passage else r"(?!\w)"
        found = list(re.finditer(pattern, text))
        if len(found) != 1:
            raise InputError(f"{page}: has {len(found)} passages like the one in results.txt, not one: {passage}")
        for group, figure in reversed([*enumerate(figures, start=1)]):
            if found[0][group].split() != figure.split():  # otherwise it may be on two lines
                text = text[: found[0].start(group)] + figure + text[found[0].end(group) :]
    return text


def passages() -> dict[str, list[str]]:
    """By page, its passages with fields for the figures."""
    pages = Path(__file__).with_suffix(".txt").read_text().split("@ ")[1:]
    return {page: list(of_page) for page, *of_page in (text.strip().split("\n\n") for text in pages)}


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
        write(results | {name: run_in(folder)})
    for page in passages():
        path = ROOT / page
        path.write_text(with_figures(path.read_text(), page, results))


if __name__ == "__main__":
    command_line(Options, main)
