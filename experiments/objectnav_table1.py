"""Searching houses for objects: Table I of the paper on dense cost maps, `python -m experiments.objectnav_table1`.

All agents make the same searches: the same houses, starts and targets. The paper's houses (Matterport3D) and its
simulator are others, so its figures stand beside ours for orientation only.
"""

import csv
import dataclasses
import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import tyro

from dc2g_jax.datasets.houses import PROCEDURAL
from dc2g_jax.datasets.tables import read_table
from dc2g_jax.errors import InputError
from dc2g_jax.objectnav.agent import CONTROLLER, MPC, Agent, Guide, RandomUntilSeen, Steering, usual_camera
from dc2g_jax.objectnav.evaluation import EpisodeResult, Summary, results_of, summarize
from dc2g_jax.objectnav.guides import Frontier, GoalReacher, NoIdea, TrueCost
from dc2g_jax.objectnav.houses import IndoorHouse, indoor_houses
from dc2g_jax.objectnav.mapping import MapSettings
from dc2g_jax.objectnav.searches import TIME_LIMIT, Episode, sample_episodes, search_all
from experiments.common import OutOption, command_line
from experiments.episodes import EpisodeProgress
from experiments.outputs import output_folder

#: What may be an agent, none of which needs a network.
AgentName = Literal["true_cost", "random", "frontier"]

#: What the tables call an agent.
TITLES = {"true_cost": "true cost map", "random": "privileged random", "frontier": "frontier, same controller"}


class PaperLine(NamedTuple):
    """A line of Table I of the paper; see `Summary`."""

    success: float
    spl: float
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]


#: Table I of the paper, on its own houses; "Our Approach" there is its network.
PAPER = {
    "true_cost": PaperLine(1.000, 0.922, 0.211, 147.459, (0.15, 2.041), (2.371, 35.006)),
    "random": PaperLine(0.250, 0.208, 7.214, 402.795, (1.607, 8.920), (28.004, 156.095)),
    "network": PaperLine(0.447, 0.329, 4.542, 327.877, (0.673, 7.318), (11.788, 128.158)),
}

#: What is said under every table.
CAVEAT = (
    "The paper's houses differ from these (they are scanned homes, Matterport3D in the Habitat simulator), and so do "
    "its robot's speed and camera: compare its lines with each other, not with ours."
)


@dataclasses.dataclass(frozen=True)
class Options:
    """Run the agents of Table I in houses they have not seen, and set them beside the paper's figures.

    Attributes:
      houses: folder of ProcTHOR houses (`train`, `val` and `test`.jsonl.gz, `asset_boxes.json`), or `procedural` for
        the embedded floor plans.
      split: `test`, or `val` while anything is still being chosen.
      count: houses, the first ones of the split.
      episodes: searches in each house, of random starts and targets.
      agents: which ones, any of true_cost, random, frontier.
      samples: copies of the plan that the controller drives at each step.
      cell_size: of the map and the houses, metres.
      limit: steps of 0.1 s after which a search ends without success.
      seed: of starts, targets and the robots' noise.
      resamples: draws of houses for the bootstrap intervals.
      out: folder to write to; a new one below outputs/ where not given.
      resume: go on with the run in `out`, begun with the same options, where it stopped.
    """

    houses: Annotated[str, tyro.conf.arg(metavar="FOLDER")] = PROCEDURAL
    split: Literal["val", "test"] = "test"
    count: int = 8
    episodes: int = 40
    agents: tuple[AgentName, ...] = ("true_cost", "random", "frontier")
    samples: int = CONTROLLER.samples
    cell_size: float = 0.1
    limit: int = TIME_LIMIT
    seed: int = 0
    resamples: int = 10_000
    out: OutOption = None
    resume: bool = False


def agent_named(name: str, options: Options) -> Agent:
    """The agent of a line of the table."""
    parts: dict[str, tuple[Guide, Steering]] = {
        "true_cost": (TrueCost(), MPC()),
        "random": (GoalReacher(NoIdea()), RandomUntilSeen()),
        "frontier": (GoalReacher(Frontier()), MPC()),
    }
    guide, steering = parts[name]
    return Agent(
        guide=guide,
        steering=steering,
        camera=usual_camera(),
        mapping=MapSettings(cell_size=options.cell_size),
        controller=dataclasses.replace(CONTROLLER, samples=options.samples),
    )


class SearchTable:
    """`episodes.csv`: one line a search and agent, written anew whenever an agent has made all of its searches.

    Opened where a run is resumed, it gives back what is there and runs the rest.

    Args:
      path: the file.

    Raises:
      InputError: the file is there and cannot be read.
    """

    def __init__(self, path: Path):
        self._path = path
        self._done = read_searches(path) if path.exists() else []

    def run(
        self, name: str, houses: Sequence[IndoorHouse], episodes: Sequence[Episode], options: Options
    ) -> list[EpisodeResult]:
        """What came of an agent's searches, made now or earlier."""
        kept = [result for result in self._done if result.agent == name]
        if len(kept) == len(episodes):
            return kept
        progress = EpisodeProgress()
        searches = search_all(
            agent_named(name, options), houses, episodes, limit=options.limit, seed=options.seed,
            on_progress=lambda finished: progress(name, finished, len(episodes)),
        )  # fmt: skip
        results = results_of(name, houses, episodes, searches)
        self._done = [*(result for result in self._done if result.agent != name), *results]
        write_searches(self._path, self._done)
        return results


def write_searches(path: Path, results: Sequence[EpisodeResult]) -> None:
    """Write `episodes.csv`, yes and no as 1 and 0. A file that is there is replaced in one go."""
    unfinished = path.with_name(f".{path.name}.unfinished")
    with unfinished.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(EpisodeResult._fields)
        for result in results:
            writer.writerow(int(value) if isinstance(value, bool) else value for value in result)
    os.replace(unfinished, path)


def read_searches(path: Path) -> list[EpisodeResult]:
    """Read what `write_searches` wrote.

    Raises:
      InputError: for a file that cannot be read, a missing column, or a value that is none; names the line.
    """
    rows = read_table(path, list(EpisodeResult._fields), remedy="give the episodes.csv of an earlier run")
    results = []
    for line, row in rows:
        try:
            results.append(EpisodeResult(**{name: _value(name, row[name]) for name in EpisodeResult._fields}))
        except ValueError as error:
            raise InputError(f"{path}: line {line}: {error}; repair the line, or run the searches anew") from None
    return results


def _value(name: str, text: str) -> Any:
    """A field of `EpisodeResult`."""
    kind = EpisodeResult.__annotations__[name]
    return bool(int(text)) if kind is bool else kind(text)


def table(summaries: Mapping[str, Summary]) -> str:
    """Table I as text: a line an agent, the paper's below it where it has one, and the paper's network."""
    columns = ("success (95 %)", "SPL (95 %)", "DTS m", "steps", "acc m/s2, rad/s2", "jerk m/s3, rad/s3")
    lines = [_line("", columns)]
    for name, one in summaries.items():
        shares = [
            f"{value:.3f} ({low:.3f} to {high:.3f})"
            for value, (low, high) in ((one.success, one.success_interval), (one.spl, one.spl_interval))
        ]
        lines.append(_line(TITLES[name], (*shares, *_figures(one))))
        lines += [_paper_line("the paper's", name)] if name in PAPER else []
    return "\n".join([*lines, _paper_line("the paper's network", "network")])


def _paper_line(title: str, name: str) -> str:
    one = PAPER[name]
    return _line(title, (f"{one.success:.3f}", f"{one.spl:.3f}", *_figures(one)))


def _figures(one: Summary | PaperLine) -> tuple[str, ...]:
    pairs = (f"{along:.2f}, {turning:.2f}" for along, turning in (one.acceleration, one.jerk))
    return f"{one.distance:.2f}", f"{one.steps:.1f}", *pairs


def _line(title: str, cells: Sequence[str]) -> str:
    widths = (22, 22, 5, 5, 16, 17)
    return "  ".join([f"{title:>25}", *(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))])


def main(options: Options) -> None:
    """Run the agents, print and write the table."""
    for name in ("count", "episodes", "samples", "limit", "resamples"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name} {getattr(options, name)}: give 1 or more")
    if not options.agents or len(set(options.agents)) < len(options.agents):
        raise InputError(f"--agents {' '.join(options.agents)}: give each agent once, one at least")
    houses = indoor_houses(options.houses, options.split, count=options.count, cell_size=options.cell_size)
    episodes = sample_episodes(houses, options.episodes, seed=options.seed)
    out = output_folder(options, "objectnav_table1")
    searches, summaries = SearchTable(out / "episodes.csv"), dict[str, Summary]()
    for name in options.agents:
        began = time.perf_counter()
        results = searches.run(name, houses, episodes, options)
        summaries[name] = summarize(results, resamples=options.resamples)
        print(f"{TITLES[name]}: {len(results)} searches, {time.perf_counter() - began:.0f} s", flush=True)
    kind = "embedded floor plans" if options.houses == PROCEDURAL else f"houses of {options.houses}"
    print(f"\n{len(episodes)} searches in {options.count} {kind}, {options.split}\n{table(summaries)}\n{CAVEAT}")
    facts = {
        "houses": [house.name for house in houses],
        "split": options.split,
        "note": CAVEAT,
        "agents": {name: one._asdict() for name, one in summaries.items()},
        "paper": {name: one._asdict() for name, one in PAPER.items()},
    }
    (out / "results.json").write_text(json.dumps(facts, indent=2) + "\n")
    print(f"Written to {out}: {', '.join(sorted(path.name for path in out.iterdir()))}")


if __name__ == "__main__":
    command_line(Options, main)
