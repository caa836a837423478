"""Shared by the experiments with object goals: options, the comparison of agents, means and tables."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro

from dc2g_jax._src.cli.common import NetworkOption, digests
from dc2g_jax._src.cli.options import OutOptions, ResumeOptions, require_positive
from dc2g_jax._src.cli.outputs import CommandOptions, output_folder, print_files
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.digests import tree_sha256
from dc2g_jax._src.files.rows import ResumableTable
from dc2g_jax._src.readers.houses import PROCEDURAL
from dc2g_jax._src.rollouts.statistics import Mean, house_bootstrap
from dc2g_jax._src.runtime.errors import check_number
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax.indoor.houses.dataset import IndoorHouse, indoor_houses
from dc2g_jax.indoor.maps.mapping import IndoorMapSettings
from dc2g_jax.indoor.search.agent import CONTROLLER, Agent
from dc2g_jax.indoor.search.evaluation import SearchResult, results_of
from dc2g_jax.indoor.search.searches import TIME_LIMIT, sample_episodes, search_all

#: Titles of the agents.
AGENT_TITLES = {
    "true_cost": "true cost map",
    "random": "privileged random",
    "frontier": "frontier",
    "predicted": "predicted cost map",
    "promising": "predicted, at frontiers",
}

#: Printed below every table.
_CAVEAT = (
    "The paper's houses differ from these (they are scanned homes, Matterport3D in the Habitat simulator), and so do "
    "its robot's speed and camera; its agent with true costs stops as soon as it sees the object: compare its lines "
    "with each other, not with ours."
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CostMapOptions(CommandOptions):
    """The network of the agents that use one.

    Attributes:
      network: folder that objectnav_train wrote, or hf://owner/name; the shipped network by default.
    """

    network: NetworkOption = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchOptions(OutOptions):
    """A search for an object in a house.

    Attributes:
      dataset: folder of ProcTHOR houses (`train`, `val` and `test`.jsonl.gz, `asset_boxes.json`), or `procedural` for
        the procedural floor plans.
      split: `val` to make choices, `test` to report results.
      samples: plans that the controller samples at each step.
      noise: noise level of camera and pose; 0 is no noise, 1 as in python -m experiments.noisy_mapping.
      limit: steps of 0.1 s after which a search ends without success.
      seed: seed of starts, targets and the robots' noise.
    """

    dataset: Annotated[str, tyro.conf.arg(metavar="FOLDER")] = PROCEDURAL
    split: Literal["val", "test"] = "test"
    samples: int = CONTROLLER.samples
    noise: float = 0.0
    limit: int = TIME_LIMIT
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("--noise", self.noise, least=0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComparisonOptions(SearchOptions, ResumeOptions):
    """Searches in several houses.

    Attributes:
      count: number of houses, from the first of the split on.
      episodes: searches in each house, from random starts for random targets.
      resamples: bootstrap samples of the houses, for the intervals.
    """

    count: int = 8
    episodes: int = 40
    resamples: int = 10_000


class SearchSummary(NamedTuple):
    """A line of Table I: means over episodes, of shares with 95 % bootstrap intervals over houses.

    Attributes:
      episodes: number of episodes.
      success: success rate (SR).
      spl: success weighted by path length.
      distance: distance to success (DTS), meters.
      steps: control periods (Time).
      acceleration: meters per second squared, and radians per second squared.
      jerk: meters per second cubed, and radians per second cubed.
      declared: share of episodes in which the robot declared success.
      collisions: control periods in which an obstacle stopped it.
    """

    episodes: int
    success: Mean
    spl: Mean
    distance: float
    steps: float
    acceleration: tuple[float, float]
    jerk: tuple[float, float]
    declared: float
    collisions: float


def summarize(results: Sequence[SearchResult], *, resamples: int = 10_000) -> SearchSummary:
    """The means and intervals of some results, one at least."""
    columns = dict(zip(SearchResult._fields, zip(*results, strict=True), strict=True))
    mean = {name: float(np.mean(values)) for name, values in columns.items() if not isinstance(values[0], str)}
    success, spl = (
        house_bootstrap(np.array(columns[name], float), columns["house"], resamples=resamples, seed=0)
        for name in ("success", "spl")
    )
    acceleration, jerk = ((mean[name], mean[f"turn_{name}"]) for name in ("acceleration", "jerk"))
    same = {name: mean[name] for name in ("distance", "steps", "declared", "collisions")}
    return SearchSummary(len(results), success, spl, acceleration=acceleration, jerk=jerk, **same)


def difference(
    better: Sequence[SearchResult], worse: Sequence[SearchResult], *, resamples: int = 10_000
) -> dict[str, Mean]:
    """Differences of `success` and `spl` between two agents in the same searches, with intervals as in `SearchSummary`.

    Raises:
      ValueError: the searches differ.
    """
    if [one[:5] for one in better] != [one[:5] for one in worse]:
        raise ValueError("the two agents made different searches")

    def gain(name: str) -> Mean:
        gains = [float(getattr(one, name)) - float(getattr(two, name)) for one, two in zip(better, worse, strict=True)]
        return house_bootstrap(gains, [one.house for one in better], resamples=resamples, seed=0)

    return {name: gain(name) for name in ("success", "spl")}


def with_interval(value: Mean, sign: str = "") -> str:
    """A mean with its interval; with a sign if `sign` is `+`."""
    middle, low, high = (f"{one:{sign}.3f}" for one in value)
    return f"{middle} ({low} to {high})"


def compare(
    command: str,
    options: ComparisonOptions,
    agents: Mapping[str, Agent],
    titles: Mapping[str, str],
    report: Callable[[list[IndoorHouse], dict[str, SearchSummary]], tuple[str, dict[str, Any]]],
    **inputs: Any,
) -> None:
    """Run the same searches with several agents. Write `episodes.csv`, and `results.json` with the agents' comparison.

    Args:
      command: name of the command.
      options: its options.
      agents: the agent of each row of the table, by name.
      titles: titles of the rows by name.
      report: makes the table as text, and contents of `results.json`, from the houses and the summary of each row.
      inputs: trees of arrays by option, which must be the same when a run is resumed.

    Raises:
      InputError: a number is below 1, there are not enough houses, or the file holds other searches.
    """
    require_positive(options, "count", "episodes", "samples", "limit", "resamples")
    where, cell_size = (options.dataset, options.split), IndoorMapSettings.cell_size
    houses = indoor_houses(*where, count=options.count, cell_size=cell_size)
    episodes = sample_episodes(houses, options.episodes, seed=options.seed)
    given = {"dataset": tree_sha256([house.world for house in houses]), **digests(**inputs)}
    out = output_folder(options, command, inputs=given)
    table, results, progress = ResumableTable(out / "episodes.csv", SearchResult), {}, EpisodeProgress()
    for name, agent in agents.items():
        began = time.perf_counter()

        def search(name: str = name, agent: Agent = agent) -> list[SearchResult]:
            searches = search_all(
                agent, houses, episodes, limit=options.limit, seed=options.seed,
                on_progress=lambda finished: progress(name, finished, len(episodes)),
            )  # fmt: skip
            return results_of(name, houses, episodes, searches)

        results[name] = table.next_results([(*episode, name) for episode in episodes], search)
        print(f"{titles[name]}: {len(episodes)} searches, {time.perf_counter() - began:.0f} s", flush=True)
    summaries = {name: summarize(found, resamples=options.resamples) for name, found in results.items()}
    text, facts = report(houses, summaries)
    kind = "procedural floor plans" if options.dataset == PROCEDURAL else f"houses of {options.dataset}"
    print(f"\n{len(episodes)} searches in {options.count} {kind}, {options.split}\n{text}\n{_CAVEAT}")
    *others, last = results
    gains = {name: difference(results[last], results[name], resamples=options.resamples) for name in others}
    for name, gain in gains.items():
        success, spl = (with_interval(value, "+") for value in gain.values())
        print(f"{titles[last]} against {titles[name]}: success {success}, SPL {spl}")
    found = {
        "houses": [house.name for house in houses],
        "split": options.split,
        "note": _CAVEAT,
        **facts,
        "differences": gains,
    }
    write_json(out / "results.json", found)
    print_files(out)
