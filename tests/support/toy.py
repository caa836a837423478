"""A toy house and episodes in it, replayed once for all tests that draw them."""

import functools

from dc2g_jax._src.figures.replay import Frames, replay_result
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.statistics import extra_steps
from tests.support.maps import drawn

HOUSE = House(
    "toy",
    "test",
    drawn("""
        ####D#....
        ..#.P.....
        ..##P..t..
        .t..P.....
        SSSSSSSSSS
        RRRRRRRRRR
        RRRRRRRRRR
    """),
)
_RANGE = 3

#: From the lower right corner to the door, looking away from it: a short way, and a long one.
_ACTIONS = {"dc2g": "RRFFFFFRFFFFFF", "frontier": "RRFFFFFFFFFRFFRFFFFLFFFF"}
_ORACLE_STEPS = 14


def _result(planner: str, actions: str) -> EpisodeResult:
    return EpisodeResult(
        "toy", 9, 6, 0, _RANGE, None, planner, True, len(actions), _ORACLE_STEPS,
        extra_steps(len(actions), _ORACLE_STEPS), "to_goal", actions,
    )  # fmt: skip


RESULTS = {planner: _result(planner, actions) for planner, actions in _ACTIONS.items()}


@functools.cache
def replayed() -> dict[str, Frames]:
    """Planner -> its replayed episode; `dc2g` goes by the exact cost-to-go."""
    rules = SETTINGS["paper"].rules(_RANGE)
    exact = {"dc2g": RESULTS["dc2g"]._replace(planner="true_cost_to_go")}
    return {planner: replay_result(result, HOUSE, rules) for planner, result in (RESULTS | exact).items()}
