"""Extra steps, and what they come to over many episodes (paper, section IV-B)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


def extra_steps(steps: int, oracle_steps: int) -> float:
    """Steps beyond the oracle's in percent, 100 (t - t_oracle) / t_oracle (paper, section IV-B).

    Raises:
      ValueError: if the oracle took no step, so that there is nothing to compare with.
    """
    if oracle_steps < 1:
        raise ValueError(f"the oracle took {oracle_steps} steps; extra steps need a start off the goal")
    return 100.0 * (steps - oracle_steps) / oracle_steps


class Summary(NamedTuple):
    """Extra steps over a set of episodes, in percent; houses weigh equally in the mean only where it says so.

    Attributes:
      mean_extra: mean.
      median_extra: median.
      quartile_25: lower quartile.
      quartile_75: upper quartile.
      success: share of episodes that reached a goal, 0 to 1.
      episodes: how many.
    """

    mean_extra: float
    median_extra: float
    quartile_25: float
    quartile_75: float
    success: float
    episodes: int


def summarize(extra: Sequence[float] | np.ndarray, success: Sequence[bool] | np.ndarray) -> Summary:
    """Summary of a non-empty set of episodes, each weighing the same.

    Raises:
      ValueError: for an empty set.
    """
    if len(extra) == 0:
        raise ValueError("no episode to summarize")
    low, median, high = np.percentile(extra, (25, 50, 75))
    return Summary(
        mean_extra=float(np.mean(extra)),
        median_extra=float(median),
        quartile_25=float(low),
        quartile_75=float(high),
        success=float(np.mean(success)),
        episodes=len(extra),
    )


def house_bootstrap(
    values: Sequence[float] | np.ndarray, houses: Sequence[str], *, resamples: int, seed: int, share: float = 0.95
) -> tuple[float, float]:
    """Interval of a mean over episodes, by drawing whole houses anew: episodes of one house are not independent.

    For a paired comparison, give the differences.

    Args:
      values: one value an episode.
      houses: the house of each episode.
      resamples: how many sets of houses are drawn, with replacement, as many as there are.
      seed: of the draws.
      share: share of the drawn means that the interval holds, 0 to 1.

    Returns:
      Lower and upper end; both the mean where all is of one house, which tells nothing of others.

    Raises:
      ValueError: for no values.
    """
    if len(values) == 0:
        raise ValueError("no episode to draw from")
    names, house = np.unique(np.asarray(houses), return_inverse=True)
    totals, counts = np.bincount(house, weights=values), np.bincount(house)
    drawn = np.random.default_rng(seed).integers(len(names), size=(resamples, len(names)))
    means = totals[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, ((1 - share) / 2, (1 + share) / 2))
    return float(low), float(high)
