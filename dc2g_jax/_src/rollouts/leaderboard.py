"""Planners compared in families of maps, from the same starts: steps relative to one of them, and a page about it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dc2g_jax._src.readers.families import family_of
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.statistics import Mean, house_bootstrap

#: Planners that know the map ahead of time: a bound for the others, no competitors.
PRIVILEGED = ("oracle", "true_cost_to_go")

#: The planner that all are compared with.
REFERENCE = "frontier"

#: Number of maps of a family below which their intervals are too narrow.
_FEW_MAPS = 6

#: Bootstrap samples of maps, and their seed.
_RESAMPLES, _SEED = 2_000, 0


class Family(NamedTuple):
    """Episodes in one family of maps, of all planners from the same starts.

    Attributes:
      maps: the map of each start.
      logarithms: planner -> logarithm of its steps `[starts]`. Failures count as the step limit.
      success: planner -> share of its episodes that reached a goal, 0 to 1.
    """

    maps: list[str]
    logarithms: dict[str, np.ndarray]
    success: dict[str, float]

    def ratio(self, planner: str, other: str = REFERENCE) -> Mean:
        """A planner's steps relative to another's: their geometric mean, and its 95 % interval over maps."""
        difference = self.logarithms[planner] - self.logarithms[other]
        interval = house_bootstrap(difference, self.maps, resamples=_RESAMPLES, seed=_SEED)
        return Mean(*map(math.exp, interval))

    def ranked(self) -> list[str]:
        """The planners that do not know the map, the best first."""
        rivals = [name for name in self.logarithms if name not in PRIVILEGED]
        return sorted(rivals, key=lambda name: self.ratio(name).mean)


#: Family of maps -> the episodes in it.
Families = Mapping[str, Family]


def families_of(results: Iterable[EpisodeResult], limit: Mapping[str, int]) -> Families:
    """Results by family.

    Args:
      results: episodes of all planners from the same starts, in the same order, in houses called `family/house`.
      limit: step limit of each house.
    """
    together: dict[str, dict[str, list[EpisodeResult]]] = {}
    for one in results:
        together.setdefault(family_of(one.house), {}).setdefault(one.planner, []).append(one)
    return {
        family: Family(
            [one.house for one in next(iter(of.values()))],
            {
                planner: np.array([math.log(one.steps if one.success else limit[one.house]) for one in own])
                for planner, own in of.items()
            },
            {planner: float(np.mean([one.success for one in own])) for planner, own in of.items()},
        )
        for family, of in together.items()
    }


def mean_ratio(families: Families, planner: str) -> float:
    """Geometric mean over families of a planner's steps relative to the reference."""
    return math.exp(sum(math.log(family.ratio(planner).mean) for family in families.values()) / len(families))


def in_order(families: Families) -> list[str]:
    """Planners by `mean_ratio`, the best first."""
    return sorted(next(iter(families.values())).logarithms, key=lambda planner: mean_ratio(families, planner))


def _sentence(name: str, family: Family, planner: str) -> str:
    first, second = family.ranked()[:2]
    ratio = family.ratio(planner, second if planner == first else first)
    interval = f"{ratio.mean:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"
    if planner == first:
        clearly = "first" if ratio.high < 1 else "first, but not clearly"
        return f"- **{name}**: {clearly}; {interval} times the steps of the second, `{second}`."
    clearly = "not first" if ratio.low > 1 else "not first, but not clearly behind"
    return f"- **{name}**: {clearly}; {interval} times the steps of `{first}`."


def _row(families: Families, planner: str) -> str:
    cells = [f"*`{planner}`*" if planner in PRIVILEGED else f"`{planner}`", f"{mean_ratio(families, planner):.2f}"]
    for family in families.values():
        ratio, success = f"{family.ratio(planner).mean:.2f}", family.success[planner]
        failed = f" ({100 * (1 - success):.0f} % fail)" if success < 1 else ""
        cells.append((f"**{ratio}**" if planner == family.ranked()[0] else ratio) + failed)
    return f"| {' | '.join(cells)} |"


#: The page. `experiments/leaderboard.py` adds to it what is about this package's own run.
PAGE = """# Leaderboard

Planners for unknown maps, in families of maps, from the same starts. Each number is the geometric mean of a planner's
steps relative to frontier exploration (`frontier`): 0.50 is half the steps. An episode that does not reach a goal
counts as its step limit. In parentheses: the number of maps of a family. In italics: planners that know the map. In
bold: the best of the others in a family. The second column is the mean over families. {settings}

{table}

![Steps relative to frontier exploration, by planner and family]({figure})

Dots are the means of the table, lines their 95 % intervals over maps.{caution}

{sentences}

In parentheses: the 95 % interval over maps, paired by start.

{how}
"""


def page(families: Families, about: Sequence[str], *, settings: str, how: str, figure: str) -> str:
    """The page `leaderboard.md`.

    Args:
      families: the episodes.
      about: planners that the page tells about.
      settings: the rules, the field of view and the split, in words.
      how: how many episodes ran, and by which command, in words.
      figure: path of the figure, relative to the page.
    """
    few = [name for name, family in families.items() if len(set(family.maps)) < _FEW_MAPS]
    caution = f"\nThose of {', '.join(few)} are too narrow: they need {_FEW_MAPS} maps or more." if few else ""
    heads = " | ".join(f"{name} ({len(set(family.maps))})" for name, family in families.items())
    table = [f"| planner | all | {heads} |", f"|---|{'---|' * (len(families) + 1)}"]
    table += [_row(families, planner) for planner in in_order(families)]
    sentences = "\n\n".join(
        "\n".join(
            [
                f"## Where `{planner}` is first, and where not\n",
                *(_sentence(name, family, planner) for name, family in families.items()),
            ]
        )
        for planner in about
    )
    return PAGE.format(
        settings=settings, table="\n".join(table), figure=figure, caution=caution, sentences=sentences, how=how
    )
