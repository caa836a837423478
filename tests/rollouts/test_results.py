"""Results: rows that hold together, arrays of them, and their summaries by group."""

import numpy as np
import pytest

from dc2g_jax._src.rollouts.results import EpisodeResult, Results, tabulate
from dc2g_jax._src.rollouts.statistics import house_bootstrap, summarize
from tests.support.refusals import refusal


def row(planner: str, house: str, extra: float, success: bool = True) -> EpisodeResult:
    steps = 10 + round(extra / 10)
    return EpisodeResult(house, 1, 2, 0, 8, None, planner, success, steps, 10, extra, "to_goal", "F" * steps)


RESULTS = Results(
    [row("oracle", "a", 0.0), row("oracle", "b", 0.0), row("mine", "a", 50.0), row("mine", "b", 100.0, False)]
)


def test_arrays_are_in_the_order_of_the_starts():
    extra, success, house = (RESULTS.array(field) for field in ("extra", "success", "house"))
    assert list(extra) == ["oracle", "mine"]
    np.testing.assert_array_equal(extra["mine"], [50.0, 100.0])
    assert (success["mine"].dtype, success["mine"].tolist()) == (bool, [True, False])
    assert house["oracle"].tolist() == ["a", "b"]
    assert RESULTS.array("steps")["mine"].dtype.kind == "i"
    refusal(lambda: RESULTS.array("extras"), "'extras'", "extra")


def test_results_are_summarized_and_saved(tmp_path):
    summary = RESULTS.summary()
    assert list(summary) == ["oracle", "mine"]
    found = {planner: (of["mean_extra"], of["success"], of["episodes"]) for planner, of in summary.items()}
    assert found == {"oracle": (0, 1, 2), "mine": (75, 0.5, 2)}
    header, *lines = str(RESULTS).splitlines()
    assert [line.split()[0] for line in (header, *lines)] == ["planner", "oracle", "mine"]
    assert {len(line) for line in lines} == {len(header)}
    RESULTS.save(tmp_path / "episodes.csv")
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 1 + len(RESULTS)
    assert RESULTS.of("mine") == RESULTS[2:]


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


def test_values_of_a_row_that_contradict_each_other_are_refused():
    row = EpisodeResult("left", 0, 0, 0, 1, None, "frontier", False, 0, 4, -100.0, "gave_up")
    row.check()
    row._replace(heading=3, steps=6, extra=50.0, actions="FFLRFF").check()
    row._replace(oracle_steps=None, extra=None).check()
    for wrong in ({"extra": None}, {"oracle_steps": None}, {"oracle_steps": None, "extra": None, "success": True}):
        with pytest.raises(ValueError, match="oracle_steps and extra"):
            row._replace(**wrong).check()
    wrong = {"x": -1, "y": -1, "heading": 4, "range": -1, "steps": 3, "actions": "F", "extra": 0.0}
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=name):
            row._replace(**{name: value}).check()
    with pytest.raises(ValueError, match="letters F, L, R"):
        row._replace(steps=1, extra=-75.0, actions="X").check()
