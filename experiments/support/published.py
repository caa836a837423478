"""The 400 published episodes: our runs compared with the authors' (paper, section IV-B)."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.readers.starts import Start, check_starts, published_episodes
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT
from dc2g_jax._src.rollouts.statistics import extra_steps, house_bootstrap
from dc2g_jax._src.runtime.progress import EpisodeProgress

#: Groups of the published episodes in tables, in order; `all` holds all episodes.
PUBLISHED_GROUPS = ("train", "same_neighborhood", "new_neighborhood", "urban", "all")


class EpisodePair(NamedTuple):
    """One episode of both sides, a row of `head_to_head.csv`.

    Attributes:
      house: name of the house.
      x: first column.
      y: first row.
      heading: first heading.
      group: group of the house.
      oracle: number of actions of our oracle.
      authors_oracle: number of actions of the authors' oracle.
      frontier: number of actions of our frontier exploration.
      authors_frontier: number of actions of the authors' frontier exploration.
      dc2g: number of actions of our DC2G, or of the planner that replaces it.
      authors_dc2g: number of actions of the authors' DC2G.
      reached: whether ours reached the door. If not, its number of actions is the step limit.
      extra: extra steps of ours beyond our oracle, in percent.
      authors_extra: extra steps of the authors' DC2G beyond the authors' oracle, in percent.
    """

    house: str
    x: int
    y: int
    heading: int
    group: str
    oracle: int
    authors_oracle: int
    frontier: int
    authors_frontier: int
    dc2g: int
    authors_dc2g: int
    reached: bool
    extra: float
    authors_extra: float


def group_by_house() -> dict[str, str]:
    """The group of each house with a published episode. Validation houses are among `train`."""
    return {start.house: group for start, group, _ in published_episodes()}


def run_published(
    table: EpisodeTable, dataset: HouseDataset, planners: Sequence[str], network: Estimator | None
) -> list[EpisodeResult]:
    """Results of the paper's 400 episodes, planner by planner."""
    runner = Runner(dataset, SETTINGS["published"], progress=EpisodeProgress())
    starts = [start for start, *_ in published_episodes()]
    check_starts(starts, dataset)
    return table.run(runner, starts, planners, network)


def authors_results() -> list[EpisodeResult]:
    """The authors' own runs, whose actions and last modes are not published."""
    ranges = SETTINGS["published"].rules()
    return [
        EpisodeResult(
            *start[:4], ranges.sensing.radius, ranges.expanding_range, f"authors_{planner}", of[planner] < STEP_LIMIT,
            of[planner], of["oracle"], extra_steps(of[planner], of["oracle"]),
            "to_goal" if of[planner] < STEP_LIMIT else "explore",
        )
        for start, _, of in published_episodes()
        for planner in ("frontier", "dc2g")
    ]  # fmt: skip


def pair_up(
    published: Sequence[tuple[Start, str, dict[str, int]]],
    frontier: Sequence[EpisodeResult],
    dc2g: Sequence[EpisodeResult],
) -> list[EpisodePair]:
    """Pair our results with the authors', in the order of the published episodes."""

    def steps(result: EpisodeResult) -> int:
        return result.steps if result.success else STEP_LIMIT

    return [
        EpisodePair(
            *start[:4],
            group,
            oracle=ours.oracle_steps,
            authors_oracle=theirs["oracle"],
            frontier=steps(blind),
            authors_frontier=theirs["frontier"],
            dc2g=steps(ours),
            authors_dc2g=theirs["dc2g"],
            reached=ours.success,
            extra=extra_steps(steps(ours), ours.oracle_steps),
            authors_extra=extra_steps(theirs["dc2g"], theirs["oracle"]),
        )
        for (start, group, theirs), blind, ours in zip(published, frontier, dc2g, strict=True)
        if ours.oracle_steps is not None
    ]


def by_group(pairs: Sequence[EpisodePair]) -> dict[str, list[EpisodePair]]:
    """The pairs of each of `PUBLISHED_GROUPS`."""
    return {group: [pair for pair in pairs if group in (pair.group, "all")] for group in PUBLISHED_GROUPS}


def compare(pairs: Sequence[EpisodePair], *, resamples: int, seed: int) -> dict[str, Any]:
    """Statistics of one group of episodes, with 95 % bootstrap intervals from `resamples` samples of its houses."""
    houses = [pair.house for pair in pairs]
    ours, authors = np.array([(pair.dc2g, pair.authors_dc2g) for pair in pairs]).T
    extra = np.array([pair.extra for pair in pairs])
    authors_extra = np.array([pair.authors_extra for pair in pairs])
    shorter, longer = int(np.sum(ours < authors)), int(np.sum(ours > authors))

    def interval(values: np.ndarray) -> list[float]:
        return [round(bound, 4) for bound in house_bootstrap(values, houses, resamples=resamples, seed=seed)[1:]]

    steps = [[(one.frontier, one.dc2g), (one.authors_frontier, one.authors_dc2g)] for one in pairs]
    frontier, dc2g = np.array(steps, float).T
    faster, authors_faster = 100 * (frontier / dc2g - 1)  # the paper's "189 % faster"
    return {
        "episodes": len(pairs),
        "houses": len(set(houses)),
        "mean_extra": round(float(extra.mean()), 4),
        "mean_extra_interval": interval(extra),
        "authors_mean_extra": round(float(authors_extra.mean()), 4),
        "difference": round(float(np.mean(extra - authors_extra)), 4),
        "difference_interval": interval(extra - authors_extra),
        "median_extra": round(float(np.median(extra)), 4),
        "authors_median_extra": round(float(np.median(authors_extra)), 4),
        "shorter": shorter,
        "equal": len(pairs) - shorter - longer,
        "longer": longer,
        "shorter_of_differing": round(shorter / max(1, shorter + longer), 4),
        "time_outs": sum(not pair.reached for pair in pairs),
        "authors_time_outs": int(np.sum(authors >= STEP_LIMIT)),
        "frontier_over_dc2g": round(float(faster.mean()), 4),
        "frontier_over_dc2g_interval": interval(faster),
        "authors_frontier_over_dc2g": round(float(authors_faster.mean()), 4),
    }


def houses_where_frontier_is_shorter(pairs: Sequence[EpisodePair]) -> dict[str, list[str]]:
    """Houses in which frontier exploration takes fewer actions than DC2G on average: `ours`, and the `authors`'."""
    more: dict[str, Counter[str]] = {"ours": Counter(), "authors": Counter()}
    for pair in pairs:
        more["ours"][pair.house] += pair.dc2g - pair.frontier
        more["authors"][pair.house] += pair.authors_dc2g - pair.authors_frontier
    return {whose: sorted(house for house, steps in own.items() if steps > 0) for whose, own in more.items()}
