"""Training of the encoder on pictures of houses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.training import loop
from dc2g_jax._src.training.loop import Log, Pauses, fit
from dc2g_jax._src.training.step import learn
from dc2g_jax.indoor.learning.midlevel import EncoderArchitecture, TrainedEncoder
from dc2g_jax.indoor.maps.camera import VIEW_SIZE, CameraView
from experiments.objectnav.encoder import Answers, EncoderTraining, encoder_task, task_losses
from tests.support.compiling import compiled_count
from tests.support.two_rooms import views_of_a_bed

ARCHITECTURE = EncoderArchitecture(widths=(4, 6, 8), features=5)


@pytest.fixture(scope="module")
def views() -> CameraView:
    return views_of_a_bed()


def test_losses_of_the_three_tasks():
    rng = np.random.default_rng(0)
    classes = rng.integers(0, 17, (1, *VIEW_SIZE)).astype(np.uint8)
    classes[classes == 3] = 0
    depth = rng.uniform(0.5, 12, (1, *VIEW_SIZE)).astype(np.float32)
    depth[0, :20] = 0
    logits, presence = rng.normal(size=(1, 12, 16, 17)), rng.normal(size=(1, 17))
    answered = rng.uniform(0, 1, (1, 12, 16))
    expected = {"segmentation": 0.0, "presence": 0.0, "depth": []}
    for row in range(12):
        for column in range(16):
            pixel = 0, 4 * row + 2, 4 * column + 2
            here = logits[0, row, column]
            expected["segmentation"] += (np.log(np.exp(here).sum()) - here[classes[pixel]]) / (12 * 16)
            if depth[pixel] > 0:
                expected["depth"].append(abs(answered[0, row, column] - min(depth[pixel], 10) / 10))
    for index in range(17):
        there = np.sum(classes == index) >= 12
        expected["presence"] += np.log1p(np.exp(-presence[0, index] if there else presence[0, index])) / 17
    expected["depth"] = np.mean(expected["depth"])
    views = CameraView(jnp.zeros((1, *VIEW_SIZE, 3), jnp.uint8), jnp.asarray(depth), jnp.asarray(classes))
    answers = Answers(*(jnp.asarray(part, jnp.float32) for part in (logits, presence, answered)))
    losses = jax.jit(task_losses)(answers, views)
    for name, value in expected.items():
        assert float(losses[name]) == pytest.approx(value, rel=1e-5), name


def train_encoder(views, folder) -> tuple[TrainedEncoder, list]:
    """The encoder after 40 steps, and its losses after every 4."""
    task = encoder_task(EncoderTraining(ARCHITECTURE, steps=40, batch_size=4), views)
    (weights,) = fit(task, folder, Pauses(4, np.inf))
    names = ("segmentation", "presence", "depth")
    losses = [{name: line[name] for name in names} for line in Log(folder).by_step().values()]
    return TrainedEncoder(weights, ARCHITECTURE), losses


@pytest.fixture(scope="module")
def trained(views, tmp_path_factory) -> tuple[TrainedEncoder, list]:
    return train_encoder(views, tmp_path_factory.mktemp("encoder"))


def test_the_encoder_learns_and_is_the_same_for_a_seed(views, trained, tmp_path):
    encoder, losses = trained
    assert len(losses) == 10
    assert sum(losses[-1].values()) < 0.5 * sum(losses[0].values())
    again, _ = train_encoder(views, tmp_path)
    jax.tree.map(np.testing.assert_array_equal, again.weights, encoder.weights)


def test_the_number_of_devices_changes_a_step_by_rounding_only(views, tmp_path, monkeypatch):
    """Each number of devices compiles the step once. 40 steps move half of the weights by 1e-2 or more."""
    jax.clear_caches()  # one of the two may have been compiled for other tests
    found, before = [], compiled_count(learn)
    for count in (1, 2):
        mesh = mesh_of(jax.devices()[:count])
        monkeypatch.setattr(loop, "mesh_for_batch", lambda size, runs, mesh=mesh: mesh)
        found.append(train_encoder(views, tmp_path / str(count)))
    assert compiled_count(learn) == before + 2
    (one, losses), (two, others) = found
    for name, loss in losses[-1].items():
        assert others[-1][name] == pytest.approx(loss, rel=1e-5)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), one.weights, two.weights)


def test_pictures_have_different_features(views, trained):
    features = trained[0].encode(views.image)
    assert not np.allclose(features[0], features[1], atol=1e-2)
