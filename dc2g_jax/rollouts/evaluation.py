"""Episodes by house name: planners run from given starts, beside the oracle (paper, section IV-B)."""

import collections
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dc2g_jax.datasets.houses import HouseDataset, stack_worlds
from dc2g_jax.datasets.starts import Start
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import Estimator
from dc2g_jax.grid.poses import ACTION_LETTERS, HEADINGS, make_pose
from dc2g_jax.grid.terrain import FRONT_DOOR
from dc2g_jax.planning.named import make_planner
from dc2g_jax.planning.planners import MODE_NAMES, Oracle, Planner
from dc2g_jax.planning.rules import Rules, Settings
from dc2g_jax.rollouts.rollout import STEP_LIMIT, Episodes, Trajectories, rollout
from dc2g_jax.rollouts.statistics import extra_steps

#: A map of this many cells has one more action in its step limit: 500 for the published ones, of 50 x 50 cells.
_CELLS_A_STEP = 50 * 50 // STEP_LIMIT

#: Planners beside those of the package: name -> what makes one from the rules of an episode.
OwnPlanners = Mapping[str, Callable[[Rules], Planner]]
NO_PLANNERS: OwnPlanners = MappingProxyType({})


class EpisodeResult(NamedTuple):
    """One episode of one planner; the columns of `episodes.csv`.

    Attributes:
      house: name of the house.
      x: first column.
      y: first row.
      heading: first heading.
      range: reach of the field of view, in cells.
      expanding_range: range of the frontier-expanding kernel in cells, `None` where the rules have none.
      planner: its name.
      success: did the robot reach a goal within the step limit?
      steps: actions taken.
      oracle_steps: actions the oracle took from the same start.
      extra: extra steps beyond the oracle's, in percent.
      mode: plan mode of the last decision.
      actions: the actions as letters F, L, R.
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
    oracle_steps: int
    extra: float
    mode: str
    actions: str


def action_letters(trajectories: Trajectories, episode: int) -> str:
    """The actions of one episode as letters F, L, R."""
    return "".join(ACTION_LETTERS[action] for action in trajectories.actions[episode][: trajectories.steps[episode]])


def episodes_from(starts: Sequence[Start], index: Mapping[str, int]) -> Episodes:
    """Starts as a rollout wants them, given each house's index in the stack of worlds."""
    table = np.array([(index[start.house], start.x, start.y, start.heading) for start in starts], np.int32)
    world, x, y, heading = table.reshape(-1, 4).T
    return Episodes(world=jnp.asarray(world), start=make_pose(x, y, heading))


class Runner:
    """Runs planners from given starts in the houses of one dataset, all episodes of a planner at once.

    Args:
      dataset: the houses.
      settings: rules by sensing range.
      step_limit: actions after which an episode ends without success; `None` for 500, and on maps of over
        50 x 50 cells, the size of the published ones, one for every five cells of the largest.
      progress: called as `progress(planner, finished, episodes)` now and then.

    Attributes:
      step_limit: actions after which an episode ends without success.

    Raises:
      InputError: the step limit is less than 1.
    """

    def __init__(
        self,
        dataset: HouseDataset,
        settings: Settings,
        *,
        step_limit: int | None = None,
        progress: Callable[[str, int, int], None] | None = None,
    ):
        self._dataset = dataset
        self._index = {house.name: number for number, house in enumerate(dataset.houses)}
        # Every house of the dataset, whether used or not: the compiled program is then the same for all requests.
        self._worlds = stack_worlds(dataset.houses)
        self._settings = settings
        if step_limit is None:
            step_limit = max(STEP_LIMIT, max(house.terrain.size for house in dataset.houses) // _CELLS_A_STEP)
        if step_limit < 1:
            raise InputError(f"step limit {step_limit}: give at least 1 (--step-limit)")
        self.step_limit = step_limit
        self._progress = progress
        self._oracles: dict[tuple[Rules, tuple[Start, ...]], Trajectories] = {}

    def rules(self, start: Start) -> Rules:
        """The rules of an episode.

        Raises:
          InputError: the start asks for an expanding range, and the settings know none.
        """
        return self._settings.rules(start.sensing_range, start.expanding_range)

    def trajectories(self, planner: Planner, rules: Rules, starts: Sequence[Start], name: str = "") -> Trajectories:
        """Run one planner from every start, whatever ranges the starts ask for.

        Args:
          planner: the planner.
          rules: whose field of view the robots have.
          starts: first poses.
          name: what progress is reported under.

        Raises:
          KeyError: for a start in a house that the dataset lacks.
        """
        episodes = episodes_from(starts, self._index)
        report = None
        if self._progress is not None:
            progress = self._progress
            report = lambda finished: progress(name, finished, len(starts))  # noqa: E731
        return rollout(
            planner,
            self._worlds,
            episodes,
            sensing=rules.sensing,
            step_limit=self.step_limit,
            on_progress=report,
        )

    def _oracle(self, rules: Rules, starts: Sequence[Start]) -> Trajectories:
        """The oracle's trajectories, run once for each set of starts."""
        key = rules, tuple(starts)
        if key not in self._oracles:
            self._oracles[key] = self.trajectories(Oracle(), rules, starts, "oracle")
        return self._oracles[key]

    def run(
        self,
        starts: Sequence[Start],
        planners: Iterable[str],
        estimator: Estimator | None = None,
        *,
        own: OwnPlanners = NO_PLANNERS,
    ) -> list[EpisodeResult]:
        """Run planners by name from every start.

        Args:
          starts: first poses; each may ask for its own ranges.
          planners: names out of `PLANNERS` and of `own`.
          estimator: the network of `dc2g`.
          own: further planners, or others in the place of those but the oracle, by name: each is made from the rules
            of an episode.

        Returns:
          Results, planner by planner in the order given, each in the order of the starts.

        Raises:
          ValueError: for a start that is no pose on the map, or on a front door: there is nothing to look for; for a
            planner of no known name; for an `oracle` of one's own, by which all are measured.
          InputError: not even the oracle reaches a goal from a start within the step limit, or a start asks for an
            expanding range, and the settings know none.
        """
        if "oracle" in own:
            raise ValueError("own: holds an oracle, by which all are measured; give the planner another name")
        for start in starts:
            terrain = self._dataset.house(start.house).terrain
            height, width = terrain.shape
            if not (0 <= start.x < width and 0 <= start.y < height and 0 <= start.heading < HEADINGS):
                raise ValueError(
                    f"{start}: is no pose on a map of {width} x {height} cells; columns, rows and headings count from 0"
                )
            if terrain[start.y, start.x] == FRONT_DOOR:
                raise ValueError(f"{start}: stands on a front door already; start elsewhere")
        by_ranges: dict[tuple[int | None, int | None], list[int]] = collections.defaultdict(list)
        for number, start in enumerate(starts):
            by_ranges[start.sensing_range, start.expanding_range].append(number)
        names = list(dict.fromkeys(planners))
        results: dict[tuple[str, int], EpisodeResult] = {}
        for numbers in by_ranges.values():
            chosen = [starts[number] for number in numbers]
            rules = self.rules(chosen[0])
            oracle = self._oracle(rules, chosen)
            if not np.all(oracle.success):
                lost = chosen[int(np.argmin(oracle.success))]
                raise InputError(
                    f"{lost}: even with the map known no goal is reached within {self.step_limit} actions; give a "
                    "larger step limit, or start elsewhere"
                )
            for name in names:
                done = oracle
                if name != "oracle":
                    planner = own[name](rules) if name in own else make_planner(name, rules, estimator)
                    done = self.trajectories(planner, rules, chosen, name)
                for row, number in enumerate(numbers):
                    results[name, number] = _result(chosen[row], rules, name, done, row, int(oracle.steps[row]))
        return [results[name, number] for name in names for number in range(len(starts))]


def _result(
    start: Start, rules: Rules, name: str, trajectories: Trajectories, row: int, oracle_steps: int
) -> EpisodeResult:
    steps = int(trajectories.steps[row])
    return EpisodeResult(
        house=start.house,
        x=start.x,
        y=start.y,
        heading=start.heading,
        range=rules.sensing.radius,
        expanding_range=rules.expanding_range,
        planner=name,
        success=bool(trajectories.success[row]),
        steps=steps,
        oracle_steps=oracle_steps,
        extra=extra_steps(steps, oracle_steps),
        mode=MODE_NAMES[trajectories.mode[row]],
        actions=action_letters(trajectories, row),
    )
