"""Results: rows that hold together, arrays of them, and their summaries by group."""

import numpy as np
import pytest

from dc2g_jax._src.rollouts.results import EpisodeResult, Results
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
