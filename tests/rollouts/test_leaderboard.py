"""Planners compared in families: ratios, who is first, and the page."""

import math
import re

import pytest

from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.rollouts.leaderboard import PAGE, families_of, in_order, mean_ratio, page
from dc2g_jax._src.rollouts.results import EpisodeResult
from tests.support.places import ROOT

#: Steps of each planner from three starts on two mazes, and from one in a house; the last start of `slow` fails.
STEPS = {"oracle": (5, 10, 10, 20), "frontier": (10, 20, 40, 50), "fast": (5, 10, 20, 60), "slow": (20, 40, 80, 3)}
HOUSES = ("mazes/a", "mazes/a", "mazes/b", "houses/c")
LIMIT = {"mazes/a": 100, "mazes/b": 100, "houses/c": 200}
FAILED = ("slow", "houses/c")

RESULTS = [
    EpisodeResult(house, 1, number, 0, complete_rules(8).sensing.radius, None, planner, (planner, house) != FAILED,
                  steps, 5, 20.0 * steps - 100, "to_goal", "F" * steps)
    for planner, of in STEPS.items()
    for number, (house, steps) in enumerate(zip(HOUSES, of, strict=True))
]  # fmt: skip


FAMILIES = families_of(RESULTS, LIMIT)


def test_ratios_are_geometric_means_of_pairs():
    mazes = FAMILIES["mazes"]
    assert mazes.ratio("fast") == (pytest.approx(1 / 2), pytest.approx(1 / 2), pytest.approx(1 / 2))
    assert (mazes.success["fast"], mazes.maps) == (1, ["mazes/a", "mazes/a", "mazes/b"])
    assert FAMILIES["houses"].ratio("frontier").mean == 1
    oracle = mazes.ratio("oracle")
    assert oracle.mean == pytest.approx(math.exp((2 * math.log(1 / 2) + math.log(1 / 4)) / 3))
    assert (oracle.low, oracle.high) == (pytest.approx(1 / 4), pytest.approx(1 / 2))  # one map or the other


def test_a_failure_counts_as_the_step_limit():
    houses = FAMILIES["houses"]
    assert (houses.ratio("slow").mean, houses.success["slow"]) == (pytest.approx(200 / 50), 0)


def test_who_is_first():
    assert in_order(FAMILIES) == ["oracle", "fast", "frontier", "slow"]
    assert mean_ratio(FAMILIES, "slow") == pytest.approx(math.sqrt(2 * 4))
    assert FAMILIES["mazes"].ranked() == ["fast", "frontier", "slow"]
    assert FAMILIES["mazes"].ratio("fast", "slow").mean == pytest.approx(1 / 4)
    assert FAMILIES["houses"].ranked()[0] == "frontier"


def test_the_page_says_where_a_planner_is_first_and_where_not():
    text = page(FAMILIES, ["fast", "slow"], settings="Rules.", how="By hand.", figure="a.png")
    assert re.findall("## Where `(.*)` is first", text) == ["fast", "slow"]
    assert "- **mazes**: not first; 4.00 (4.00 to 4.00) times the steps of `fast`." in text
    assert "| planner | all | mazes (2) | houses (1) |" in text
    assert "| `fast` | 0.77 | **0.50** | 1.20 |" in text
    assert "| *`oracle`* | 0.40 | 0.40 | 0.40 |" in text
    assert "| `slow` | 2.83 | 2.00 | 4.00 (100 % fail) |" in text
    assert "- **mazes**: first; 0.50 (0.50 to 0.50) times the steps of the second, `frontier`." in text
    assert "- **houses**: not first; 1.20 (1.20 to 1.20) times the steps of `frontier`." in text
    assert "intervals over maps.\nThose of mazes, houses are too narrow: they need 6 maps or more.\n" in text
    assert "](" not in text.replace("](a.png)", "")  # no links to pages that the user does not have


def test_intervals_over_six_maps_are_not_too_narrow():
    results = [one._replace(house=f"mazes/{number}") for one in RESULTS[:1] for number in range(6)]
    families = families_of([one._replace(planner=name) for name in ("frontier", "fast") for one in results], {})
    text = page(families, ["fast"], settings="Rules.", how="By hand.", figure="a.png")
    assert "intervals over maps.\n\n##" in text


def test_the_documents_have_a_page_of_this_form():
    """And nothing but what `experiments.leaderboard` adds."""
    shown = (ROOT / "docs" / "leaderboard.md").read_text()
    start = 0
    for part in re.split(r"\{\w+\}", PAGE):
        assert part in shown[start:], part
        start = shown.index(part, start)
