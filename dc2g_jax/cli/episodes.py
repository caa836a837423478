"""Episodes that commands run: their progress, and the table `episodes.csv` that keeps them."""

import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from dc2g_jax.datasets.starts import Start
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import Estimator
from dc2g_jax.files.tables import read_table
from dc2g_jax.planning.rules import Rules
from dc2g_jax.rollouts.evaluation import NO_PLANNERS, EpisodeResult, OwnPlanners, Results, Runner
from dc2g_jax.rollouts.statistics import extra_steps


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


class EpisodeTable:
    """`episodes.csv`, written anew whenever a planner has run all its episodes.

    Opened where a run is resumed, it gives back what is there and runs the rest.

    Args:
      path: the file.

    Raises:
      InputError: if the file is there and cannot be read.
    """

    def __init__(self, path: Path):
        self._path = path
        self._kept = read_episodes(path) if path.exists() else []
        self._done: list[EpisodeResult] = []

    def run(
        self,
        runner: Runner,
        starts: Sequence[Start],
        planners: Sequence[str],
        estimator: Estimator | None = None,
        *,
        own: OwnPlanners = NO_PLANNERS,
    ) -> list[EpisodeResult]:
        """What `Runner.run` gives, planner by planner, each kept as soon as it is done."""
        results: list[EpisodeResult] = []
        for planner in planners:
            episodes = self._take_kept(runner, starts, planner)
            if episodes is None:
                episodes = runner.run(starts, [planner], estimator, own=own)
                self._done += episodes
                write_episodes(self._path, self._done)
            results += episodes
        return results

    def _take_kept(self, runner: Runner, starts: Sequence[Start], planner: str) -> list[EpisodeResult] | None:
        """The next of the kept episodes, if they are the ones asked for; a run asks in the same order every time."""
        own = self._kept[: len(starts)]
        if len(own) < len(starts) or not all(
            _is_of(result, start, runner.rules(start), planner) for result, start in zip(own, starts, strict=True)
        ):
            self._kept = []
            return None
        self._kept = self._kept[len(starts) :]
        self._done += own
        return own


def _is_of(result: EpisodeResult, start: Start, rules: Rules, planner: str) -> bool:
    """Is it the planner's episode from this start, by these rules?"""
    asked = (*start[:4], rules.sensing.radius, rules.expanding_range, planner)
    return asked == (*result[:4], result.range, result.expanding_range, result.planner)


def write_episodes(path: Path, results: Sequence[EpisodeResult]) -> None:
    """Write `episodes.csv`, see `dc2g_jax.rollouts.evaluation.Results.save`."""
    Results(results).save(path)


def read_episodes(path: Path) -> list[EpisodeResult]:
    """Read what `write_episodes` wrote.

    Raises:
      InputError: for a file that cannot be read, a missing column, or a value that is none; names the line.
    """
    optional = ("expanding_range", "actions")  # some rules have none; a planner may give up at once
    columns = [name for name in EpisodeResult._fields if name not in (*optional, "extra")]
    rows = read_table(path, columns, optional=optional, remedy="give the episodes.csv of an earlier run")
    return [_episode(path, line, row) for line, row in rows]


def _episode(path: Path, line: int, row: dict[str, str]) -> EpisodeResult:
    try:
        steps, oracle_steps = int(row["steps"]), int(row["oracle_steps"])
        return EpisodeResult(
            house=row["house"],
            x=int(row["x"]),
            y=int(row["y"]),
            heading=int(row["heading"]),
            range=int(row["range"]),
            expanding_range=int(row["expanding_range"]) if row["expanding_range"] else None,
            planner=row["planner"],
            success=bool(int(row["success"])),
            steps=steps,
            oracle_steps=oracle_steps,
            extra=extra_steps(steps, oracle_steps),
            mode=row["mode"],
            actions=row["actions"],
        )
    except ValueError as error:
        raise InputError(f"{path}: line {line}: {error}; repair the line, or run the episodes anew") from None
