"""The figures of a search, in a house of two rooms."""

import dataclasses
import json

import pytest

from dc2g_jax.indoor.houses import dataset as houses
from experiments import objectnav_fig5
from experiments.objectnav_fig5 import Options, main
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms

OPTIONS = Options(split="val", target="plant", agent="random", samples=8, limit=20)


@pytest.fixture(autouse=True)
def two_rooms_alone(monkeypatch):
    for module in (houses, objectnav_fig5):
        monkeypatch.setattr(module, "indoor_houses", lambda *args, **options: [two_rooms()])


@pytest.mark.slow
def test_it_searches_and_draws(tmp_path, capsys):
    out = tmp_path / "out"
    main(dataclasses.replace(OPTIONS, out=out))
    assert {path.name for path in out.iterdir()} == {
        "fig5.png", "fig5.svg", "fig5.pdf", "search.gif", "search.rrd", "search.json", "run.json"
    }  # fmt: skip
    assert (out / "fig5.png").stat().st_size > 20_000
    facts = json.loads((out / "search.json").read_text())
    assert (facts["house"], facts["target"], facts["agent"]) == ("two_rooms", "plant", "random")
    moments = [moment["step"] for moment in facts["moments"]]
    assert moments == [0, 5, 10, 15]
    leads = set(facts["goal_reacher_leads"])
    doing = ["goal reacher" if step in leads else "exploring" for step in moments]
    assert [moment["doing"] for moment in facts["moments"]] == doing
    assert 0 < facts["steps"] <= 20
    assert facts["driven"] <= 0.1 * facts["steps"]
    printed = capsys.readouterr().out
    assert "two_rooms, plant, privileged random" in printed
    assert "shortest path" in printed


@pytest.mark.slow
def test_an_agent_with_a_network_also_shows_a_prediction(tmp_path):
    out = tmp_path / "out"
    main(dataclasses.replace(OPTIONS, agent="promising", limit=10, out=out))
    assert {path.name for path in out.iterdir()} >= {"fig4.png", "fig4.svg", "fig5.png"}


@pytest.mark.parametrize(
    ("wrong", "mentions"),
    [
        ({"dataset": "folder", "house": "val-99"}, ("called val-99", "val", "give", "two_rooms")),
        ({"house": "val-07"}, ("called val-07", "val-0", "give")),
        ({"target": "sofa"}, ("no class", "'sofa'", "plant, couch")),
        ({"target": "sink"}, ("two_rooms", "no sink", "give", "bed, plant, or another house")),
        ({"target": "couch"}, ("no couch", "two_rooms", "give", "bed, plant")),
        ({"limit": 0}, ("--limit 0", "of at least 1")),
    ],
)
def test_what_is_not_there_is_refused(wrong, mentions, tmp_path):
    refusal(lambda: main(dataclasses.replace(OPTIONS, **wrong, out=tmp_path / "out")), *mentions)
    assert not (tmp_path / "out").exists()
