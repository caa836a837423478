"""The command of Table II, on a house of two rooms."""

import dataclasses
import json

import jax
import pytest

from dc2g_jax._src.estimation.checkpoints import write_network
from dc2g_jax._src.estimation.weights import fresh_weights
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, SmallEncoder
from dc2g_jax.indoor.learning.networks import COST_MAPS, ENCODER_FOLDER, CostMapArchitecture, CostMapNetwork
from experiments import objectnav_table2
from experiments.objectnav.losses import OF_CLASSES
from experiments.objectnav_table2 import METRICS, Options, main
from experiments.support import searches
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms

KEY = jax.random.key(0)
SMALL = CostMapArchitecture(widths=(4, 4), embedding=4, features=7, feature_width=3)


@pytest.fixture
def folders(tmp_path):
    """Networks that know nothing, one shown the map alone, one shown both."""
    made = []
    for name in ("semantic", "both"):
        folder = tmp_path / name
        small = EncoderArchitecture((4, 5, 6), features=7)
        write_network(folder / ENCODER_FOLDER, fresh_weights(SmallEncoder, small, KEY), small, ENCODER)
        architecture = dataclasses.replace(SMALL, inputs=name)
        write_network(folder, fresh_weights(CostMapNetwork, architecture, KEY), architecture, COST_MAPS)
        made.append(folder)
    return tuple(made)


@pytest.fixture
def options(folders, tmp_path, monkeypatch):
    monkeypatch.setattr(searches, "indoor_houses", lambda *args, **options: [two_rooms()])
    collection = dataclasses.replace(objectnav_table2.CollectionConfig(), journeys=1, views=4, places=1)
    monkeypatch.setattr(
        objectnav_table2, "CollectionConfig", lambda **wanted: dataclasses.replace(collection, **wanted)
    )
    return Options(
        count=1, episodes=2, samples=4, limit=10, resamples=20, maps=16, networks=folders, out=tmp_path / "out"
    )


@pytest.mark.slow
def test_it_compares_what_networks_are_shown(options, capsys):
    main(options)
    printed = capsys.readouterr().out
    for words in ("only semantic map", "both against only semantic map", "78.76", "80.68", "The paper's houses differ"):
        assert words in printed
    facts = json.loads((options.out / "results.json").read_text())
    assert list(facts["prediction"]) == list(facts["navigation"]) == ["semantic", "both"]
    for name in ("semantic", "both"):
        assert list(facts["prediction"][name]) == [*METRICS, *OF_CLASSES]
        assert all(0 <= value <= 100 for value in facts["prediction"][name].values())
        assert facts["navigation"][name]["episodes"] == 2
    assert set(facts["differences"]) == {"semantic"}

    weights = fresh_weights(CostMapNetwork, SMALL, jax.random.key(1))
    write_network(options.networks[1], weights, SMALL, COST_MAPS)
    again = dataclasses.replace(options, resume=True)
    refusal(lambda: main(again), options.out, "--networks", "has changed")


def test_two_networks_of_a_kind_and_unknown_agents_are_refused(options, folders):
    twice = dataclasses.replace(options, networks=(folders[0], folders[0]))
    refusal(lambda: main(twice), "--networks", folders[0], "one of each")
    refusal(lambda: main(dataclasses.replace(options, maps=17)), "--maps 17", "multiple of 16")
    refusal(lambda: main(dataclasses.replace(options, agent="frontier")), "frontier", "promising, predicted")
