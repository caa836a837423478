"""What every part of the benchmark is given."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

from dc2g_jax._src.environments.functional import SENSING_RANGE
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import Planner
from dc2g_jax._src.planning.rules import SETTINGS, Rules

from .machine import BANDWIDTH, WORD_ARITHMETIC
from .rows import Row
from .timing import Measured, measure
from .work import count_work
from .workload import Robots, Workload, active_robots

#: Robots in the middle of their episodes that batches are made of.
_POOL = 2048

#: PyTorch's rows, and whether its compiler is used.
PYTORCH = {"PyTorch": False, "PyTorch, compiled": True}


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """Workload, thoroughness and what the machine can do.

    Attributes:
      workload: houses and starts.
      network: the estimator of `dc2g`.
      repeats: how often everything is timed.
      quick: smaller and fewer cases, to see that everything runs.
      peaks: the most the machine does, by resource, in units a second.
    """

    workload: Workload
    network: NetworkCostToGo
    repeats: int
    quick: bool
    peaks: Mapping[str, float]

    def measure(self, call: Callable[[], Any]) -> Measured:
        """Time a call."""
        return measure(call, repeats=self.repeats, shortest_repeat=0.0 if self.quick else 0.1)

    def rules(self, sensing_range: int = SENSING_RANGE) -> Rules:
        """The rules everything is measured by: those of the authors' code, as in the recorded episodes."""
        return SETTINGS["reference"].rules(sensing_range)

    def planner(self, name: str, sensing_range: int = SENSING_RANGE) -> Planner:
        """A planner by name."""
        return planner_with(name, self.rules(sensing_range), self.network)

    @functools.cached_property
    def _led_by_frontier(self) -> Robots:
        count = 64 if self.quick else _POOL
        return active_robots(self.workload, self.planner("frontier"), self.rules().sensing, count)

    def robots(self, planner: str) -> Robots:
        """Robots in the middle of their episodes, led by `frontier`: all planners are measured in the same places.

        The others' states are those of a first step.
        """
        led = self._led_by_frontier
        return led if planner == "frontier" else led._replace(state=self.planner(planner).init(led.world))

    def shares(self, seconds: float, function: Callable[..., Any], *arguments: Any) -> dict[str, float]:
        """What part of the machine's bandwidth and arithmetic a kernel reaches in its time, from its counted work."""
        work = count_work(function, *arguments)
        return {
            BANDWIDTH: work.bytes / seconds / self.peaks[BANDWIDTH],
            WORD_ARITHMETIC: work.operations / seconds / self.peaks[WORD_ARITHMETIC],
        }


def own(section: str, what: str, unit: str, **more: Any) -> Row:
    """A row of this package."""
    return Row(section=section, what=what, by="dc2g_jax", unit=unit, **more)
