"""The command of Table I, on a house of two rooms."""

import dataclasses
import json

import pytest

from dc2g_jax._src.files.rows import read_rows
from dc2g_jax.indoor.search.evaluation import SearchResult
from experiments.objectnav_table1 import Options, main
from experiments.support import searches
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms

OPTIONS = Options(count=1, episodes=2, agents=("random",), samples=4, limit=10, resamples=20)


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
