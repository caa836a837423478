"""Extra steps, and their statistics over many episodes (paper, section IV-B)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


def extra_steps(steps: int, oracle_steps: int) -> float:
    """Extra steps beyond the oracle's in percent, 100 (t - t_oracle) / t_oracle (paper, section IV-B).

    Raises:
      ValueError: the oracle took no step.
    """
    if oracle_steps < 1:
        raise ValueError(f"the oracle took {oracle_steps} steps; extra steps need a start off the goal")
    return 100.0 * (steps - oracle_steps) / oracle_steps


#: Bootstrap samples of houses for intervals in summaries, and their seed.
_RESAMPLES, _SEED = 10_000, 0

#: Houses that are drawn at a time, at most some megabytes.
_DRAWN_AT_A_TIME = 1_000_000


def summarize(
    extra: Sequence[float] | np.ndarray, success: Sequence[bool] | np.ndarray, houses: Sequence[str] | None = None
) -> dict[str, float]:
    """Extra steps over a set of episodes, in percent. Each episode has the same weight.

    Returns:
      `mean_extra`, `median_extra`, `quartile_25` and `quartile_75`; `success`, the share of episodes that reached a
      goal, 0 to 1; the number of `episodes`; and `mean_low` and `mean_high`, the ends of the 95 % interval of the mean,
      see `house_bootstrap`, NaN if no houses are given.

    Raises:
      ValueError: there are no episodes.
    """
    if len(extra) == 0:
        raise ValueError("no episode to summarize")
    lower, median, upper = np.percentile(extra, (25, 50, 75)).tolist()
    low = high = math.nan
    if houses is not None:
        _, low, high = house_bootstrap(extra, houses, resamples=_RESAMPLES, seed=_SEED)
    return {
        "mean_extra": float(np.mean(extra)),
        "median_extra": median,
        "quartile_25": lower,
        "quartile_75": upper,
        "success": float(np.mean(success)),
        "episodes": len(extra),
        "mean_low": low,
        "mean_high": high,
    }


class Mean(NamedTuple):
    """A mean with the lower and upper end of its interval."""

    mean: float
    low: float
    high: float


def house_bootstrap(
    values: Sequence[float] | np.ndarray, houses: Sequence[str], *, resamples: int, seed: int, share: float = 0.95
) -> Mean:
    """A mean over episodes, with its bootstrap interval over houses, since episodes of a house are not independent.

    For a paired comparison, give the differences.

    Args:
      values: one value per episode.
      houses: the house of each episode.
      resamples: number of bootstrap samples, each with as many houses as there are, drawn with replacement.
      seed: seed of the bootstrap.
      share: share of the bootstrap means inside the interval, 0 to 1.

    Returns:
      The mean, and the ends of its interval. With a single house, all are the mean.

    Raises:
      ValueError: there are no values.
    """
    if len(values) == 0:
        raise ValueError("no episode to draw from")
    names, house = np.unique(np.asarray(houses), return_inverse=True)
    totals, counts = np.bincount(house, weights=values), np.bincount(house)
    rng, rows, means = np.random.default_rng(seed), max(1, _DRAWN_AT_A_TIME // len(names)), np.empty(resamples)
    for part in np.split(means, range(rows, resamples, rows)):
        drawn = rng.integers(len(names), size=(len(part), len(names)))
        part[:] = totals[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, ((1 - share) / 2, (1 + share) / 2))
    return Mean(float(np.mean(values)), float(low), float(high))
