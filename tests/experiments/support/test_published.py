"""Statistics of both sides of the same episodes, from pairs made by hand."""

import json

import pytest

from dc2g_jax._src.readers.starts import published_episodes
from dc2g_jax._src.rollouts.results import EpisodeResult
from experiments.support.groups import tabulate
from experiments.support.published import (
    PUBLISHED_GROUPS,
    EpisodePair,
    authors_results,
    compare,
    group_by_house,
    houses_where_frontier_is_shorter,
    pair_up,
)
from tests.support.places import ROOT


def pair(
    house: str, *, dc2g: int, authors: int, frontier: int, authors_frontier: int = 300, oracle: int = 50
) -> EpisodePair:
    return EpisodePair(
        house=house,
        x=0,
        y=0,
        heading=0,
        group="urban",
        oracle=oracle,
        authors_oracle=oracle,
        frontier=frontier,
        authors_frontier=authors_frontier,
        dc2g=dc2g,
        authors_dc2g=authors,
        reached=dc2g < 500,
        extra=100 * (dc2g / oracle - 1),
        authors_extra=100 * (authors / oracle - 1),
    )


def test_figures_of_a_few_pairs():
    pairs = [
        pair("a", dc2g=50, authors=75, frontier=100),
        pair("a", dc2g=60, authors=60, frontier=240),
        pair("b", dc2g=100, authors=75, frontier=50),
        pair("c", dc2g=55, authors=500, frontier=165, authors_frontier=500),
    ]
    found = compare(pairs, resamples=200, seed=0)
    assert (found["episodes"], found["houses"]) == (4, 3)
    assert (found["shorter"], found["equal"], found["longer"]) == (2, 1, 1)
    assert found["shorter_of_differing"] == pytest.approx(2 / 3, abs=1e-4)
    assert found["mean_extra"] == pytest.approx((0 + 20 + 100 + 10) / 4)
    assert found["median_extra"] == pytest.approx(15)
    assert found["authors_mean_extra"] == pytest.approx((50 + 20 + 50 + 900) / 4)
    assert found["authors_median_extra"] == pytest.approx(50)
    assert found["difference"] == pytest.approx((130 - 1020) / 4)
    assert found["frontier_over_dc2g"] == pytest.approx(100 * (2 + 4 + 0.5 + 3) / 4 - 100)
    assert found["authors_frontier_over_dc2g"] == pytest.approx(100 * (4 + 5 + 4 + 1) / 4 - 100)
    assert (found["time_outs"], found["authors_time_outs"]) == (0, 1)
    lost = compare([*pairs, pair("d", dc2g=500, authors=75, frontier=100)], resamples=200, seed=0)
    assert lost["time_outs"] == 1


def test_figures_have_four_decimals():
    one = pair("a", dc2g=70, authors=80, frontier=100, authors_frontier=290, oracle=30)
    other = one._replace(dc2g=90, authors_dc2g=70)
    found = compare([one, other, other], resamples=10, seed=0)
    assert (found["mean_extra"], found["median_extra"]) == (133.3333, 133.3333)
    assert (found["authors_mean_extra"], found["authors_median_extra"]) == (166.6667, 166.6667)
    assert (found["difference"], found["difference_interval"]) == (-33.3333, [-33.3333, -33.3333])
    assert found["shorter_of_differing"] == 0.3333
    assert compare([one], resamples=10, seed=0)["shorter_of_differing"] == 1
    assert (found["frontier_over_dc2g"], found["authors_frontier_over_dc2g"]) == (21.6931, 297.0238)


def test_an_episode_that_gave_up_counts_as_many_actions_as_the_step_limit():
    theirs = published_episodes()[0]
    start = theirs[0]
    ours = EpisodeResult(
        start.house, start.x, start.y, start.heading, 5, 4, "dc2g", success=False, steps=3, oracle_steps=50,
        extra=-94.0, mode="gave_up", actions="FFF",
    )  # fmt: skip
    (found,) = pair_up([theirs], [ours._replace(planner="frontier", success=True, steps=120)], [ours])
    assert (found.reached, found.dc2g, found.frontier, found.extra) == (False, 500, 120, 900)
    with pytest.raises(ValueError, match="zip"):
        pair_up([theirs], [ours], [])


def test_houses_in_which_frontier_exploration_is_shorter():
    pairs = [
        pair("a", dc2g=50, authors=75, frontier=100),
        pair("b", dc2g=90, authors=301, frontier=100),
        pair("b", dc2g=120, authors=300, frontier=100),
        pair("c", dc2g=100, authors=75, frontier=100),
    ]
    assert houses_where_frontier_is_shorter(pairs) == {"ours": ["b"], "authors": ["b"]}


def test_the_authors_frontier_exploration_is_as_in_the_paper():
    pairs = [
        pair(start.house, dc2g=1, authors=of["dc2g"], frontier=2, authors_frontier=of["frontier"], oracle=of["oracle"])
        for start, _, of in published_episodes()
    ]
    assert len({one.house for one in pairs}) == 73
    expected = {"ours": [], "authors": ["n001m000h001", "n002m001h007"]}
    assert houses_where_frontier_is_shorter(pairs) == expected
    assert compare(pairs, resamples=1, seed=0)["authors_frontier_over_dc2g"] == pytest.approx(189.8, abs=0.05)


def test_the_authors_table_is_the_published_one():
    stored = json.loads((ROOT / "docs" / "results.json").read_text())["fig7"]["published"]
    table = tabulate(authors_results(), PUBLISHED_GROUPS, group_by_house())
    for planner, row in table.items():
        for group, summary in row.items():
            for name, value in stored[planner][group].items():
                assert summary[name] == pytest.approx(value, abs=1e-3), (planner, group, name)
