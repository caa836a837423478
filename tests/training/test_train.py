"""Training from start to end by one call."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.training.loop import Pauses
from tests.support.houses import STREET, house
from tests.support.refusals import refusal

DATASET = HouseDataset("two", "folder", (house("street", STREET), house("lane", STREET[:, ::-1].copy(), "val")))
CONFIG = dc2g.TrainingConfig(Architecture((4, 4)), steps=3, batch_size=2)
DATA = dc2g.DataConfig(extra_houses=0, starts_per_house=1, ranges=(3,), field_of_view=120)
RARELY = Pauses(validate_every=0)


def test_houses_become_a_network_that_is_evaluated_and_kept(tmp_path):
    trained = dc2g.train(tmp_path, DATASET, config=CONFIG, data=DATA, pauses=RARELY, split="val")
    assert trained.network.architecture == dataclasses.replace(CONFIG.architecture, side=10)
    assert {row.house for row in trained.results} == {"lane"}
    assert set(trained.results.summary()) == {"frontier", "dc2g"}
    kept = dc2g.load_network(tmp_path / "network")
    jax.tree.map(np.testing.assert_array_equal, kept.weights, trained.network.weights)
    written = (tmp_path / "network" / "network.json").read_bytes()
    assert json.loads(written)["steps"] == 3
    assert json.loads(written)["masks"].endswith("sensing ranges 3 cells and 120 degrees")
    # It is finished: nothing is trained anew, and another call gives the same.
    again = dc2g.train(tmp_path, DATASET, config=CONFIG, data=DATA, pauses=RARELY, split=None)
    assert again.results is None
    jax.tree.map(np.testing.assert_array_equal, again.network.weights, trained.network.weights)
    assert (tmp_path / "network" / "network.json").read_bytes() == written
    shutil.rmtree(tmp_path / "network")
    dc2g.train(tmp_path, DATASET, config=CONFIG, data=DATA, pauses=RARELY, split=None)
    assert (tmp_path / "network" / "network.json").read_bytes() == written
    other = dataclasses.replace(CONFIG, seed=1)
    refusal(lambda: dc2g.train(tmp_path, DATASET, config=other, data=DATA, pauses=RARELY), "seed was 0", "now 1")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"split": "test", "pauses": RARELY}, ["test", "use another split"]),
        ({"config": dataclasses.replace(CONFIG, architecture=Architecture(network="nets:None_"))}, ["'nets:None_'"]),
        ({"pauses": Pauses(validate_every=-1)}, ["--validate-every -1"]),
        ({"config": dataclasses.replace(CONFIG, losses=(("l3", 1.0),))}, ["l3", "give one of quantile, l1"]),
        ({"split": "valid"}, ["no split is called 'valid'"]),
        ({"episodes_every": -1}, ["--episodes-every -1"]),
    ],
)
def test_what_cannot_be_trained_is_refused_before_anything_is_written(tmp_path, options, words):
    refusal(lambda: dc2g.train(tmp_path / "new", DATASET, **{"config": CONFIG, "data": DATA, **options}), *words)
    assert not (tmp_path / "new").exists()
