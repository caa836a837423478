"""Episodes of commands: their table `episodes.csv`, and the networks of their planners."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from dc2g_jax._src.cli.outputs import CommandOptions
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.files.rows import ResumableTable
from dc2g_jax._src.planning.named import NETWORK_PLANNERS
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts.evaluation import Planners, Runner, by_name, open_networks
from dc2g_jax._src.rollouts.results import EpisodeResult

#: Maximum number of episodes of a planner to run and write together. It limits memory, and the loss after a kill.
EPISODES_A_SHARD = 65_536


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworksOptions(CommandOptions):
    """One or several networks for the planners that use one.

    Attributes:
      network: folder of a trained network, or hf://owner/name; package.module:Name for an estimator of your own; the
        shipped network by default. Of several, each is run, and named by the end of its place: `dc2g (folder)`.
    """

    network: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FOLDER ...", help_behavior_hint="")] = ()

    def open(self, planners: Iterable[str]) -> Estimator | dict[str, Estimator] | None:
        """The network, or several by name; `None` if no planner uses one."""
        return open_networks(self.network or None) if NETWORK_PLANNERS.keys() & set(planners) else None


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
        network: Estimator | Mapping[str, Estimator] | None = None,
    ) -> list[EpisodeResult]:
        """The results of `Runner.run`. Each shard is saved when it finishes.

        Raises:
          InputError: the file holds other episodes; or see `Runner.run`.
        """
        return [result for shard in self.shards(runner, starts, planners, network) for result in shard]

    def shards(
        self,
        runner: Runner,
        starts: Sequence[Start],
        planners: Planners,
        network: Estimator | Mapping[str, Estimator] | None = None,
    ) -> Iterator[list[EpisodeResult]]:
        """The same in parts, for more episodes than fit in memory.

        Raises:
          InputError: as `run`.
        """
        for planner, source in by_name(planners, network).items():
            for first in range(0, len(starts), EPISODES_A_SHARD):
                part = starts[first : first + EPISODES_A_SHARD]
                ranges = [(rules.sensing.radius, rules.expanding_range) for rules in map(runner.rules, part)]
                asked = [(*start[:4], *both, planner) for start, both in zip(part, ranges, strict=True)]
                yield self.next_results(asked, functools.partial(runner.run, part, {planner: source}))
