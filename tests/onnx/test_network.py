"""A network in ONNX answers as it does here."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.compact_unet import Architecture, apply
from dc2g_jax._src.estimation.estimators import ExactCostToGo, NetworkCostToGo
from dc2g_jax._src.files.digests import arrays_sha256
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from tests.support.networks import random_network
from tests.support.refusals import refusal

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

from dc2g_jax.onnx import export_onnx  # noqa: E402
from dc2g_jax.onnx.command import Options, main  # noqa: E402


def wanted_of(network: NetworkCostToGo, classes: np.ndarray) -> np.ndarray:
    quantiles = apply(network.architecture, network.weights, jnp.asarray(classes))
    return np.moveaxis(np.asarray(quantiles), -1, 1)


def answers(path, classes: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (quantiles,) = session.run(None, {"classes": classes})
    return quantiles


@pytest.mark.parametrize("shape", [(1, 50, 50), (3, 50, 50), (2, 27, 41), (1, 1, 2)])
def test_the_shipped_network_answers_alike(tmp_path, shape):
    main(Options(out=tmp_path / "network.onnx"))
    network = dc2g.load_network()
    classes = np.random.default_rng(0).integers(0, len(CLASS_NAMES), shape).astype(np.uint8)
    wanted = wanted_of(network, classes)
    np.testing.assert_allclose(answers(tmp_path / "network.onnx", classes), wanted, rtol=1e-4, atol=1e-3)
    assert wanted.std() > 1


@pytest.mark.parametrize(("patch", "embedding"), [(2, 0), (5, 6)])
def test_every_layer_counts(tmp_path, patch, embedding):
    network = random_network(Architecture((3, 5, 4, 6), (0.25, 0.75), cost_scale=7.0, patch=patch, embedding=embedding))
    export_onnx(network, tmp_path / "network.onnx")
    classes = np.random.default_rng(2).integers(0, len(CLASS_NAMES), (2, 19, 22)).astype(np.uint8)
    wanted = wanted_of(network, classes)
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(answers(tmp_path / "network.onnx", classes), wanted, atol=1e-5 * scale)


def test_the_file_says_what_it_is(tmp_path):
    network = random_network(Architecture((4, 4, 4, 4), (0.5,), cost_scale=7.0, embedding=6))
    export_onnx(network, tmp_path / "network.onnx")
    model = onnx.load(tmp_path / "network.onnx")
    assert {entry.key: json.loads(entry.value) for entry in model.metadata_props} == {
        "classes": list(CLASS_NAMES), "quantiles": [0.5], "cost_scale": 7.0, "side": 50,
        "sha256": arrays_sha256(network.weights),
    }  # fmt: skip


def test_what_cannot_be_exported_is_refused(tmp_path):
    own = NetworkCostToGo({}, Architecture(network="my_package.networks:Mine"))
    for estimator in (ExactCostToGo(), own):
        refusal(lambda: export_onnx(estimator, tmp_path / "network.onnx"), "only compact networks", "dc2g train")  # noqa: B023
    refusal(
        lambda: export_onnx(dc2g.load_network(), tmp_path / "none" / "network.onnx"),
        "none/network.onnx",
        "cannot be written",
    )
    (tmp_path / "mine.onnx").write_text("mine")
    refusal(lambda: main(Options(out=tmp_path / "mine.onnx")), "mine.onnx", "exists already")
    refusal(lambda: main(Options(tmp_path, out=tmp_path / "new.onnx")), "network.json")
    assert {path.name for path in tmp_path.iterdir()} == {"mine.onnx"}
