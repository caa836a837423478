"""Episodes of commands: their table `episodes.csv`."""

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.files.rows import ResumableTable
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.evaluation import Planners, Runner, by_name
from dc2g_jax._src.rollouts.results import EpisodeResult

#: Maximum number of episodes of a planner to run and write together. It limits memory, and the loss after a kill.
EPISODES_A_SHARD = 65_536


class EpisodeTable(ResumableTable[EpisodeResult]):
    """`episodes.csv`. Each shard of a planner's episodes is appended when it finishes.

    Args:
      path: the file.

    Raises:
      InputError: the file exists and cannot be read.
    """

    def __init__(self, path: Path):
        super().__init__(path, EpisodeResult)

    def run(
        self,
        runner: Runner,
        starts: Sequence[Start],
        planners: Planners,
        estimator: Estimator | None = None,
    ) -> list[EpisodeResult]:
        """The results of `Runner.run`. Each shard is saved when it finishes.

        Raises:
          InputError: the file holds other episodes; or see `Runner.run`.
        """
        return [result for shard in self.shards(runner, starts, planners, estimator) for result in shard]

    def shards(
        self,
        runner: Runner,
        starts: Sequence[Start],
        planners: Planners,
        estimator: Estimator | None = None,
    ) -> Iterator[list[EpisodeResult]]:
        """The same in parts, for more episodes than fit in memory.

        Raises:
          InputError: as `run`.
        """
        for planner, source in by_name(planners).items():
            for first in range(0, len(starts), EPISODES_A_SHARD):
                part = starts[first : first + EPISODES_A_SHARD]
                ranges = [(rules.sensing.radius, rules.expanding_range) for rules in map(runner.rules, part)]
                asked = [(*start[:4], *both, planner) for start, both in zip(part, ranges, strict=True)]
                yield self.next_results(asked, functools.partial(runner.run, part, {planner: source}, estimator))
