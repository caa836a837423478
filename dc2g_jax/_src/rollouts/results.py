"""Results of episodes: one row each, and many of them as rows, as arrays and as summaries."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dc2g_jax._src.files.rows import write_rows
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.grid.poses import ACTION_LETTERS, HEADINGS
from dc2g_jax._src.planning.planners import Mode
from dc2g_jax._src.rollouts.rollout import Trajectories
from dc2g_jax._src.rollouts.statistics import extra_steps, summarize
from dc2g_jax._src.runtime.errors import check_name, short

#: Largest error of extra steps in a table, in percent: earlier versions wrote one or two digits.
_ROUNDING = 0.1


class EpisodeResult(NamedTuple):
    """One episode of one planner, a row of `episodes.csv`.

    Attributes:
      house: name of the house.
      x: first column.
      y: first row.
      heading: first heading.
      range: range of the field of view, in cells.
      expanding_range: range of the frontier-expanding kernel in cells, `None` if the rules have none.
      planner: name of the planner.
      success: whether the robot reached a goal within the step limit.
      steps: number of actions.
      oracle_steps: number of actions of the oracle from the same start, `None` where no goal can be reached.
      extra: extra steps beyond the oracle's, in percent; `None` where no goal can be reached.
      mode: plan mode of the last decision.
      actions: the actions as letters F, L, R; empty if the planner gave up at once.
    """

    house: str
    x: int
    y: int
    heading: int
    range: int
    expanding_range: int | None
    planner: str
    success: bool
    steps: int
    oracle_steps: int | None
    extra: float | None
    mode: Mode
    actions: str = ""

    def check(self) -> None:
        """Check that the values of a row belong together, such as one that was read from a file.

        Raises:
          ValueError: they do not.
        """
        if min(self.x, self.y, self.heading, self.range, self.steps) < 0 or self.heading >= HEADINGS:
            raise ValueError(f"x {self.x}, y {self.y}, heading {self.heading}, range {self.range}, {self.steps} steps")
        if set(self.actions) - set(ACTION_LETTERS):
            raise ValueError(f"actions {short(self.actions)} are not letters {', '.join(ACTION_LETTERS)}")
        if self.actions and len(self.actions) != self.steps:
            raise ValueError(f"{len(self.actions)} actions for {self.steps} steps")
        if self.oracle_steps is None or self.extra is None:
            if self.success or self.oracle_steps != self.extra:
                raise ValueError("oracle_steps and extra must both be given, or both be empty without success")
        elif not abs(self.extra - extra_steps(self.steps, self.oracle_steps)) < _ROUNDING:
            raise ValueError(f"extra is {self.extra} for {self.steps} steps and {self.oracle_steps} of the oracle")


def action_letters(trajectories: Trajectories, episode: int) -> str:
    """The actions of one episode as letters F, L, R."""
    return "".join(ACTION_LETTERS[action] for action in trajectories.actions[episode][: trajectories.steps[episode]])


class Results(tuple[EpisodeResult, ...]):
    """A tuple of results of one or more planners: planner by planner, each in the order of the starts.

    `print(results)` shows the summary of each planner.
    """

    def of(self, planner: str) -> "Results":
        """The episodes of one planner."""
        return Results(result for result in self if result.planner == planner)

    def array(self, field: str) -> dict[str, np.ndarray]:
        """One field of all episodes as an array for each planner, `[starts]`, in the order of the starts.

        ```
        extra = results.array("extra")
        print(np.mean(extra["frontier"] - extra["dc2g"]))
        ```

        Args:
          field: a field of `EpisodeResult`.

        Raises:
          InputError: there is no such field.
        """
        check_name("field of a result", field, EpisodeResult._fields)
        values: dict[str, list[object]] = {}
        for result in self:
            values.setdefault(result.planner, []).append(getattr(result, field))
        return {planner: np.array(own) for planner, own in values.items()}

    def summary(self) -> dict[str, Mapping[str, float]]:
        """For each planner `mean_extra`, `median_extra`, `quartile_25` and `quartile_75`, extra steps in percent;
        `success`, 0 to 1; the number of `episodes`; and `mean_low` and `mean_high`, the 95 % interval of the mean over
        houses. Episodes from whose start no goal can be reached are left out.
        """
        reachable = Results(one for one in self if one.extra is not None)
        extra, success, houses = map(reachable.array, ("extra", "success", "house"))
        return {planner: summarize(extra[planner], success[planner], houses[planner].tolist()) for planner in extra}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `episodes.csv`: one row per episode and planner, with `success` as 0 or 1 and `extra` in percent."""
        write_rows(Path(path), EpisodeResult, self)

    def __str__(self) -> str:
        """See `as_text`."""
        return as_text(self.summary())


def as_text(table: Mapping[str, Mapping[str, float]]) -> str:
    """A table: extra steps beyond the oracle and success, a line for each planner."""
    rows = (
        (
            planner,
            f"{of['mean_extra']:.1f}",
            f"{of['median_extra']:.1f}",
            f"{100 * of['success']:.1f}",
            f"{of['episodes']:,}",
        )
        for planner, of in table.items()
    )
    return text_table(("planner", "extra steps %: mean", "median", "success %", "episodes"), rows)
