"""Planners compared in families of maps, from the same starts: steps relative to one of them, and a page about it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dc2g_jax._src.readers.families import family_of
from dc2g_jax._src.rollouts.evaluation import EpisodeResult
from dc2g_jax._src.rollouts.statistics import house_bootstrap

#: Planners that know the map ahead of time: a bound for the others, no competitors.
PRIVILEGED = ("oracle", "true_cost_to_go")

#: Bootstrap samples of maps, and their seed.
_RESAMPLES, _SEED = 2_000, 0


class Standing(NamedTuple):
    """One planner in one family of maps.

    Attributes:
      ratio: its steps relative to the reference from the same starts: the geometric mean.
      low: lower end of the 95 % interval over maps.
      high: upper end.
      success: share of its episodes that reached a goal, 0 to 1.
      episodes: number of its episodes.
    """

    ratio: float
    low: float
    high: float
    success: float
    episodes: int


#: Planner -> family -> standing.
Standings = Mapping[str, Mapping[str, Standing]]


class Leader(NamedTuple):
    """The best planner of a family, and how another one compares with it from the same starts.

    Attributes:
      family: the family.
      leader: the planner with the lowest ratio, of those that do not know the map.
      ratio: steps of the other planner relative to the leader's; relative to the second's if it leads itself.
      low: lower end of the 95 % interval over maps.
      high: upper end.
      next_best: the second planner.
    """

    family: str
    leader: str
    ratio: float
    low: float
    high: float
    next_best: str


def _logarithms(results: Iterable[EpisodeResult], limit: Mapping[str, int]) -> dict[str, dict[str, np.ndarray]]:
    """Planner -> family -> logarithm of the steps, in the order of the starts. Failures count as the step limit."""
    steps: dict[str, dict[str, list[float]]] = {}
    for one in results:
        family = family_of(one.house)
        counted = one.steps if one.success else limit[one.house]
        steps.setdefault(one.planner, {}).setdefault(family, []).append(math.log(counted))
    return {planner: {family: np.array(own) for family, own in of.items()} for planner, of in steps.items()}


def _relative(difference: np.ndarray, maps: Sequence[str]) -> tuple[float, float, float]:
    """Geometric mean of ratios, given as logarithms, and its interval over maps."""
    mean, low, high = house_bootstrap(difference, maps, resamples=_RESAMPLES, seed=_SEED)
    return math.exp(mean), math.exp(low), math.exp(high)


def standings(results: Sequence[EpisodeResult], limit: Mapping[str, int], reference: str = "frontier") -> Standings:
    """Every planner in every family, relative to a reference.

    Args:
      results: episodes of all planners from the same starts, in the same order, in houses called `family/house`.
      limit: step limit of each house.
      reference: the planner that the others are compared with.
    """
    logs, maps, success = _logarithms(results, limit), _maps(results), _success(results)
    return {
        planner: {
            family: Standing(
                *_relative(own - logs[reference][family], maps[family]), success[planner, family], len(own)
            )
            for family, own in of.items()
        }
        for planner, of in logs.items()
    }


def _maps(results: Sequence[EpisodeResult]) -> dict[str, list[str]]:
    """Family -> the map of every start."""
    maps: dict[str, list[str]] = {}
    for one in results:
        if one.planner == results[0].planner:
            maps.setdefault(family_of(one.house), []).append(one.house)
    return maps


def _success(results: Iterable[EpisodeResult]) -> dict[tuple[str, str], float]:
    """(planner, family) -> share of episodes that reached a goal."""
    reached: dict[tuple[str, str], list[bool]] = {}
    for one in results:
        reached.setdefault((one.planner, family_of(one.house)), []).append(one.success)
    return {key: float(np.mean(own)) for key, own in reached.items()}


def leaders(results: Sequence[EpisodeResult], limit: Mapping[str, int], table: Standings, planner: str) -> list[Leader]:
    """The best planner of each family, and how `planner` compares with it. Planners that know the map are left out."""
    logs, maps = _logarithms(results, limit), _maps(results)
    found = []
    for family in maps:
        ranked = sorted((name for name in table if name not in PRIVILEGED), key=lambda name: table[name][family].ratio)
        first, second = ranked[0], ranked[1]
        other = second if planner == first else first
        found.append(
            Leader(family, first, *_relative(logs[planner][family] - logs[other][family], maps[family]), second)
        )
    return found


def mean_logarithm(row: Mapping[str, Standing]) -> float:
    """Mean over families of the logarithm of a planner's ratio."""
    return sum(math.log(own.ratio) for own in row.values()) / len(row)


def in_order(table: Standings) -> list[str]:
    """Planners by the mean over families of the logarithm of their ratio, the best first."""
    return sorted(table, key=lambda name: mean_logarithm(table[name]))


def _sentence(one: Leader, planner: str) -> str:
    """How a planner does in a family, in words."""
    interval = f"{one.ratio:.2f} ({one.low:.2f} to {one.high:.2f})"
    if one.leader == planner:
        clearly = "first" if one.high < 1 else "first, but not clearly"
        return f"- **{one.family}**: {clearly}; {interval} times the steps of the second, `{one.next_best}`."
    clearly = "not first" if one.low > 1 else "not first, but not clearly behind"
    return f"- **{one.family}**: {clearly}; {interval} times the steps of `{one.leader}`."


_PAGE = """---
hide: [navigation]
---

# Leaderboard

Planners for unknown maps, in families of maps, from the same starts. Each number is the geometric mean of a planner's
steps relative to frontier exploration (`frontier`): 0.50 is half the steps. An episode that does not reach the door
counts as its step limit. In parentheses: the number of maps of a family. In italics: planners that know the map. In
bold: the best of the others in a family. The second column is the mean over families. {settings}

Nothing of the package was chosen on the split `test`. Networks learned in published training houses and procedural
ones of other seeds, `recurrent_policy` in procedural houses, mazes, halls and offices of other seeds. [What each
planner does](reference/rivals.md).

{table}

![Steps relative to frontier exploration, by planner and family]({figure})

Dots are the means of the table, lines their 95 % intervals over maps.

{sentences}

In parentheses: the 95 % interval over maps, paired by start.

## How it was made

{how}

## Your planner, your maps

One line enters a planner, `package.module:Class` ([Write a planner](tutorials/write_a_planner.md)):

```bash
dc2g compare --planner frontier dc2g my_planner:MyPlanner
```

One line enters a family: a folder of maps, a folder of OpenStreetMap extracts, or `package.module:name` of a function
that returns a `HouseDataset` ([Your own map](tutorials/your_own_map.md)):

```bash
dc2g compare --family mazes my_maps/ my_module:my_dataset
```

Choose and tune with `--split val`.
"""


def page(
    table: Standings, first: Mapping[str, Sequence[Leader]], *, maps: Mapping[str, int], settings: str, how: str,
    figure: str,
) -> str:  # fmt: skip
    """The page `leaderboard.md`.

    Args:
      table: the standings.
      first: planner that the page tells about, one at least -> the best ones beside it, see `leaders`.
      maps: number of maps of each family.
      settings: the rules and the field of view, in words.
      how: how many episodes ran, how long and by which command, in words.
      figure: path of the figure, relative to the page.
    """
    leader = {one.family: one.leader for one in next(iter(first.values()))}
    rows = [f"| planner | all | {' | '.join(f'{family} ({maps[family]})' for family in leader)} |"]
    rows.append(f"|---|{'---|' * (len(leader) + 1)}")
    for name in in_order(table):
        cells = [f"{math.exp(mean_logarithm(table[name])):.2f}"]
        for family, best in leader.items():
            own = table[name][family]
            failed = f" ({100 * (1 - own.success):.0f} % fail)" if own.success < 1 else ""
            cells.append((f"**{own.ratio:.2f}**" if best == name else f"{own.ratio:.2f}") + failed)
        rows.append(f"| {f'*`{name}`*' if name in PRIVILEGED else f'`{name}`'} | {' | '.join(cells)} |")
    sentences = "\n\n".join(
        "\n".join([f"## Where `{planner}` is first, and where not\n", *(_sentence(one, planner) for one in each)])
        for planner, each in first.items()
    )
    return _PAGE.format(settings=settings, table="\n".join(rows), figure=figure, sentences=sentences, how=how)
