"""Tables of results by group of houses."""

from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.statistics import house_bootstrap, summarize
from experiments.support.groups import tabulate


def row(planner: str, house: str, extra: float, success: bool = True) -> EpisodeResult:
    steps = 10 + round(extra / 10)
    return EpisodeResult(house, 1, 2, 0, 8, None, planner, success, steps, 10, extra, "to_goal", "F" * steps)


def test_intervals_in_a_table_are_over_the_houses_of_each_group():
    values = [("x", 0.0), ("x", 40.0), ("y", 10.0), ("z", 5.0), ("z", 7.0)]
    episodes = [row("dc2g", house, extra) for house, extra in values]
    table = tabulate(episodes, ("a", "b", "all"), {"x": "a", "y": "a", "z": "b"})["dc2g"]
    assert (table["a"]["mean_low"], table["a"]["mean_high"]) == (10, 20)  # house y or house x alone
    assert (table["b"]["mean_low"], table["b"]["mean_high"]) == (6, 6)
    whole = house_bootstrap([one[1] for one in values], [one[0] for one in values], resamples=10_000, seed=0)
    assert tuple(table["all"][name] for name in ("mean_extra", "mean_low", "mean_high")) == whole


def test_a_table_has_a_column_for_each_group_and_one_for_all():
    episodes = [row("mine", "n", 10.0), row("mine", "o", 30.0, False), row("other", "n", 50.0)]
    table = tabulate(episodes, ("old", "urban", "new", "all"), {"n": "new", "o": "old"})
    assert {planner: list(of) for planner, of in table.items()} == {
        "mine": ["old", "new", "all"],
        "other": ["new", "all"],
    }
    assert table["mine"]["all"] == summarize([10.0, 30.0], [True, False], ["n", "o"])
    assert table["mine"]["old"] == summarize([30.0], [False], ["o"])
    assert table["other"]["new"] == table["other"]["all"] == summarize([50.0], [True], ["n"])
