"""The command of Table I, on a house of two rooms."""

import dataclasses
import json

import pytest

from dc2g_jax._src.files.rows import read_rows
from dc2g_jax.indoor.search.evaluation import SearchResult
from experiments.objectnav_table1 import Options, main
from experiments.support import searches
from experiments.support.searches import difference, summarize
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms

OPTIONS = Options(count=1, episodes=2, agents=("random",), samples=4, limit=10, resamples=20)


#: A search that succeeds, and one that does not.
GOOD = SearchResult("house", "plant", 4.0, -1.0, 0.0, "one", True, True, 0.8, 1.2, 1.5, 0.0, 20, 3, 0.1, 0.2, 0.3, 0.4)
BAD = GOOD._replace(success=False, spl=0.0, distance=2.5)


@pytest.fixture
def houses(monkeypatch):
    monkeypatch.setattr(searches, "indoor_houses", lambda *args, **options: [two_rooms()])


def test_it_writes_tables_and_resumes(houses, tmp_path, capsys, monkeypatch):
    options = dataclasses.replace(OPTIONS, out=tmp_path / "out")
    main(options)
    printed = capsys.readouterr().out
    for words in ("privileged random", "the paper's", "0.208", "The paper's houses differ"):
        assert words in printed
    results = read_rows(options.out / "episodes.csv", SearchResult)
    assert [(one.house, one.agent, one.steps) for one in results] == [("two_rooms", "random", 10)] * 2
    facts = json.loads((options.out / "results.json").read_text())
    assert facts["agents"]["random"]["episodes"] == 2
    assert facts["agents"]["random"]["steps"] == 10
    assert facts["paper"]["true_cost"]["spl"] == 0.922

    monkeypatch.setattr(searches, "search_all", lambda *args, **options: pytest.fail("searched again"))
    main(dataclasses.replace(options, resume=True))
    assert read_rows(options.out / "episodes.csv", SearchResult) == results

    other = two_rooms()
    other.world.heights[0, 0] += 1
    monkeypatch.setattr(searches, "indoor_houses", lambda *args, **options: [other])
    refusal(lambda: main(dataclasses.replace(options, resume=True)), options.out, "--dataset", "has changed")


def test_a_broken_table_is_named_with_its_line(tmp_path):
    path = tmp_path / "episodes.csv"
    fields = SearchResult._fields
    path.write_text(",".join(fields) + "\n" + ",".join(["x"] * len(fields)) + "\n")
    refusal(lambda: read_rows(path, SearchResult), path, "line 2", "repair")


@pytest.mark.parametrize(
    "wrong", [{"count": 0}, {"samples": 0}, {"noise": -1.0}, {"agents": ()}, {"agents": ("random", "random")}]
)
def test_numbers_that_are_none_are_refused(wrong, tmp_path):
    refusal(lambda: main(dataclasses.replace(OPTIONS, **wrong, out=tmp_path / "out")), "give")


def test_means_are_over_episodes_and_intervals_over_houses():
    results = [GOOD._replace(house="a"), BAD._replace(house="b"), GOOD._replace(house="a"), GOOD._replace(house="a")]
    summary = summarize(results, resamples=200)
    assert summary.success == (0.75, 0, 1)
    assert summary.spl.mean == pytest.approx(0.75 * GOOD.spl)
    assert summary.distance == pytest.approx(BAD.distance / 4)


def test_differences_are_of_the_same_searches():
    better, worse = [GOOD, GOOD._replace(house="b")], [BAD, GOOD._replace(house="b")]
    found = difference(better, worse, resamples=200)
    assert found["success"] == (0.5, 0, 1)
    assert found["spl"].mean == pytest.approx(GOOD.spl / 2)
    with pytest.raises(ValueError, match="different searches"):
        difference(better, worse[::-1])
