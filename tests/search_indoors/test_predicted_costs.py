"""A trained network and its encoder, read from a folder."""

import hashlib
import json

import jax
import numpy as np
import pytest

from dc2g_jax._src.estimation.weights import fresh_weights, write_network
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.search_indoors.learning.midlevel import EncoderArchitecture, SmallEncoder, vector_size
from dc2g_jax._src.search_indoors.learning.networks import (
    BOTH,
    CostMapArchitecture,
    CostMapEstimator,
    CostMapNetwork,
    save_estimator,
)
from dc2g_jax._src.search_indoors.search.predicted_costs import ENCODER_FILE, NETWORK_FILE, load_costs
from tests.support.refusals import refusal

KEY = jax.random.key(0)


def save_network(folder, features):
    architecture = CostMapArchitecture(widths=(6, 8), embedding=4, features=features, feature_width=3)
    save_estimator(
        folder / NETWORK_FILE, CostMapEstimator(fresh_weights(CostMapNetwork, architecture, KEY), architecture), {}
    )


@pytest.fixture
def folder(tmp_path):
    architecture = EncoderArchitecture((4, 5, 6), features=7)
    write_network(tmp_path / ENCODER_FILE, fresh_weights(SmallEncoder, architecture, KEY), architecture, {})
    save_network(tmp_path, features=7)
    return tmp_path


def test_the_shipped_network_is_the_one_on_its_card():
    folder = resource("weights/cost_maps_indoors")
    costs, card = load_costs(folder), json.loads((folder / "network.json").read_text())
    assert costs.estimator.architecture.inputs == BOTH
    assert vector_size(costs.encoder) == costs.estimator.architecture.features
    for name, digest in card["sha256"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert sum(path.stat().st_size for path in folder.iterdir()) <= 8e6


def test_both_files_are_read(folder):
    costs = load_costs(folder)
    assert costs.estimator.architecture.features == vector_size(costs.encoder) == 7
    embedding = fresh_weights(CostMapNetwork, costs.estimator.architecture, KEY)["target"]["embedding"]
    np.testing.assert_allclose(costs.estimator.weights["target"]["embedding"], embedding, rtol=1e-3)


def test_what_does_not_go_together_or_is_not_there_is_refused(folder, tmp_path):
    save_network(folder, features=5)
    refusal(lambda: load_costs(folder), folder, "7 features", "takes 5", "one folder")
    (folder / ENCODER_FILE).unlink()
    refusal(lambda: load_costs(folder), folder, ENCODER_FILE, "dc2g objectnav train")
