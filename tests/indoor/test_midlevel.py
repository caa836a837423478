"""Mid-level features: pictures of houses, and the encoder of a file."""

import jax
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import CARD, write_network
from dc2g_jax._src.estimation.weights import fresh_weights
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, SmallEncoder, TrainedEncoder, load_encoder
from dc2g_jax.indoor.learning.networks import load_costs
from dc2g_jax.indoor.maps.camera import VIEW_SIZE, CameraView
from dc2g_jax.indoor.maps.classes import BED, OBJECT_COLORS
from tests.support.refusals import refusal
from tests.support.two_rooms import views_of_a_bed

ARCHITECTURE = EncoderArchitecture(widths=(4, 6, 8), features=5)


@pytest.fixture(scope="module")
def views() -> CameraView:
    return views_of_a_bed()


def test_a_picture_shows_what_stands_there(views):
    assert views.image.shape == (2, *VIEW_SIZE, 3)
    bed = np.asarray(views.classes[0] == BED)
    assert bed.mean() > 0.1
    assert not np.asarray(views.classes[1]).any()
    color = np.asarray(views.image)[0][bed].mean(axis=0)
    assert np.abs(color - OBJECT_COLORS[BED]).max() < 60
    # The camera is half a meter away from the wall behind it, and the bed's near side 0.7 m ahead.
    assert 0.65 < float(views.depth[0][bed].min()) < 0.75
    assert float(views.depth[1, VIEW_SIZE[0] // 2, VIEW_SIZE[1] // 2]) < 1.0


def test_an_encoder_comes_back_from_its_file(views, tmp_path):
    weights = fresh_weights(SmallEncoder, ARCHITECTURE, jax.random.key(0))
    encoder = TrainedEncoder(weights, ARCHITECTURE)
    write_network(tmp_path, encoder.weights, encoder.architecture, ENCODER)
    loaded = load_encoder(tmp_path)
    assert loaded.architecture == ARCHITECTURE
    features = encoder.encode(views.image)
    assert features.shape == (2, 5)
    np.testing.assert_allclose(loaded.encode(views.image), features, atol=1e-2)
    refusal(
        lambda: load_costs(tmp_path), tmp_path / CARD, "'encoder'", "cost_maps", "python -m experiments.objectnav_train"
    )
