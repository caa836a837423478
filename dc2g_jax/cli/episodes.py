"""Episodes that commands run: their progress, and the table `episodes.csv` that keeps them."""

import functools
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from dc2g_jax.datasets.starts import Start
from dc2g_jax.estimation.estimators import Estimator
from dc2g_jax.rollouts.evaluation import NO_PLANNERS, EpisodeResult, OwnPlanners, Runner
from dc2g_jax.rollouts.results import ResumableTable


class EpisodeProgress:
    """One progress bar after another, each of one planner's episodes; fed by `dc2g_jax.rollouts.evaluation.Runner`."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None

    def __call__(self, planner: str, finished: int, episodes: int) -> None:
        """Show that a planner has finished so many of its episodes."""
        if self._bar is None:
            self._bar = tqdm(total=episodes, desc=f"{planner:>16}", unit="episode", file=sys.stderr)
        self._bar.update(finished - self._bar.n)
        if finished >= episodes:
            self._bar.close()
            self._bar = None


class EpisodeTable(ResumableTable[EpisodeResult]):
    """`episodes.csv`, written anew whenever a planner has run all its episodes.

    Args:
      path: the file.

    Raises:
      InputError: if the file is there and cannot be read.
    """

    def __init__(self, path: Path):
        super().__init__(path, EpisodeResult)

    def run(
        self,
        runner: Runner,
        starts: Sequence[Start],
        planners: Sequence[str],
        estimator: Estimator | None = None,
        *,
        own: OwnPlanners = NO_PLANNERS,
    ) -> list[EpisodeResult]:
        """What `Runner.run` gives, planner by planner, each kept as soon as it is done.

        Raises:
          InputError: the file holds other episodes; or see there.
        """
        rules = [runner.rules(start) for start in starts]
        results: list[EpisodeResult] = []
        for planner in planners:
            asked = [
                (*start[:4], own_rules.sensing.radius, own_rules.expanding_range, planner)
                for start, own_rules in zip(starts, rules, strict=True)
            ]
            run = functools.partial(runner.run, starts, [planner], estimator, own=own)
            results += self.next_results(asked, run)
        return results
