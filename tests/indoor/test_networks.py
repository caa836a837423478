"""The network that predicts cost maps: what it is shown, where features go, and how it is kept in a file."""

import dataclasses
import functools
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import CARD, WEIGHTS, write_network
from dc2g_jax._src.estimation.weights import fresh_weights, shapes_of_weights
from dc2g_jax._src.files.resources import resource
from dc2g_jax.indoor.learning import networks
from dc2g_jax.indoor.learning.midlevel import ENCODER, EncoderArchitecture, SmallEncoder
from dc2g_jax.indoor.learning.networks import (
    BINS,
    COST_MAPS,
    ENCODER_FOLDER,
    CostMapArchitecture,
    CostMapNetwork,
    Prediction,
    bin_regions,
    heading_bin,
    load_costs,
    oriented_features,
)
from dc2g_jax.indoor.maps.classes import SEMANTIC_CLASSES
from tests.support.refusals import refusal

SMALL = CostMapArchitecture(widths=(6, 8), embedding=4, features=5, feature_width=3)


@pytest.fixture(scope="module")
def weights():
    """Random throughout: fresh ones have layers of zeros, behind which nothing is seen."""
    rng = np.random.default_rng(1)
    return jax.tree.map(
        lambda leaf: rng.normal(0, 0.2, leaf.shape).astype(np.float32), shapes_of_weights(CostMapNetwork, SMALL)
    )


@pytest.fixture(scope="module")
def question():
    """Two robots, maps of 20 x 28 cells."""
    rng = np.random.default_rng(0)
    maps = rng.integers(0, 2, (2, 36, 20, 28)).astype(np.float32)
    return maps, np.array([0, 3]), np.float32([0.1, -2.0]), rng.normal(size=(2, 5)).astype(np.float32)


@functools.cache
def apply_with(inputs):
    return jax.jit(functools.partial(networks.apply, dataclasses.replace(SMALL, inputs=inputs)))


def answers(inputs, weights, question, **changed):
    names = ("maps", "target", "heading", "features")
    given = dict(zip(names, question, strict=True)) | changed
    prediction = apply_with(inputs)(weights, *(given[name] for name in names))
    return np.stack([prediction.occupancy, prediction.cost])


def test_a_number_for_each_cell(weights, question):
    answer = answers(SMALL.inputs, weights, question)
    assert answer.shape == (2, 2, 20, 28)
    assert ((answer[0] > 0) & (answer[0] < 1)).all()


def test_all_that_is_known_matters(weights, question):
    answer = answers(SMALL.inputs, weights, question)
    other = {
        "maps": question[0][::-1].copy(),
        "target": question[1] + 1,
        "heading": question[2] + np.float32(math.pi / 2),
        "features": -question[3],
    }
    for name, value in other.items():
        assert not np.allclose(answers(SMALL.inputs, weights, question, **{name: value}), answer), name


def test_ablations_are_blind_to_what_they_are_not_shown(weights, question):
    maps = question[0].copy()
    semantic = np.arange(36) % 18 < SEMANTIC_CLASSES
    maps[:, semantic] = 1 - maps[:, semantic]
    other_features = {"features": -question[3], "heading": question[2] + 2}
    for inputs, unseen, seen in (
        ("semantic", other_features, {"maps": maps}),
        ("midlevel", {"maps": maps}, other_features),
    ):
        answer = answers(inputs, weights, question)
        np.testing.assert_array_equal(answers(inputs, weights, question, **unseen), answer)
        assert not np.allclose(answers(inputs, weights, question, **seen), answer)
    # Obstacles and explored cells are shown to all.
    maps = question[0].copy()
    maps[:, ~semantic] = 1 - maps[:, ~semantic]
    assert not np.allclose(answers("midlevel", weights, question, maps=maps), answers("midlevel", weights, question))


def test_features_lie_where_the_robot_looks():
    degrees = np.array([0, 22, 23, 45, 90, 135, 180, -180, -90, -45, -22, 359, 720])
    bins = [0, 0, 1, 1, 2, 3, 4, 4, 6, 7, 0, 0, 0]
    assert heading_bin(jnp.asarray(np.radians(degrees), jnp.float32)).tolist() == bins
    regions = bin_regions(9, 12)
    assert regions.sum(axis=(1, 2)).tolist() == [12] * BINS
    assert not regions.sum(axis=0)[3:6, 4:8].any()  # the middle belongs to none
    assert regions.sum(axis=0).max() == 1
    for number in range(BINS):
        row, column = np.argwhere(regions[number]).mean(axis=0)
        direction = math.atan2(4 - row, (column - 5.5) * 9 / 12)
        assert direction == pytest.approx(math.remainder(number * math.pi / 4, math.tau), abs=1e-6) or number == 4
    north = oriented_features(jnp.asarray([[2.0, 3.0]]), jnp.asarray([math.pi / 2]), 9, 12)
    np.testing.assert_array_equal(north[0, 0, 5], [2, 3])
    assert float(jnp.sum(north)) == 12 * 5


def test_occupied_cells_lie_over_the_cost():
    prediction = Prediction(jnp.asarray([[-1.0, 1.0]]), jnp.asarray([[0.3, 0.4]]))
    np.testing.assert_array_equal(prediction.fused_cost, np.float32([[0.3, np.inf]]))


def test_the_default_is_small():
    sizes = [
        math.prod(leaf.shape) for leaf in jax.tree.leaves(shapes_of_weights(CostMapNetwork, CostMapArchitecture()))
    ]
    assert sum(sizes) <= 2_000_000


@pytest.mark.parametrize(
    "change", [{"widths": (8,)}, {"widths": (8, 0)}, {"patch": 0}, {"features": 0}, {"inputs": "all"}]
)
def test_architectures_without_sense_are_refused(change):
    with pytest.raises(ValueError, match="give"):
        dataclasses.replace(SMALL, **change)


@pytest.fixture
def folder(weights, tmp_path):
    """A network beside its encoder."""
    small = EncoderArchitecture((4, 5, 6), features=5)
    encoder = fresh_weights(SmallEncoder, small, jax.random.key(0))
    write_network(tmp_path / ENCODER_FOLDER, encoder, small, ENCODER)
    write_network(tmp_path, weights, SMALL, COST_MAPS, {"houses": "own"})
    return tmp_path


def test_a_network_comes_back_from_its_folder(weights, question, folder):
    loaded = load_costs(folder)
    assert loaded.architecture == SMALL
    assert loaded.encoder.architecture.features == 5
    np.testing.assert_allclose(
        answers(SMALL.inputs, loaded.weights, question), answers(SMALL.inputs, weights, question), atol=2e-2
    )


def test_estimated_costs_are_meters_beyond_the_best_cell_where_nothing_is_in_the_way(weights, question, folder):
    loaded, image = load_costs(folder), np.random.default_rng(2).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    maps, target, heading, _ = (jnp.asarray(part[1]) for part in question)
    found = np.asarray(jax.jit(loaded.estimate)(maps, target, heading, jnp.asarray(image)))
    features = np.tile(loaded.encoder.encode(jnp.asarray(image)[None]), (2, 1))
    occupancy, cost = answers(SMALL.inputs, loaded.weights, question, features=features)[:, 1]
    clear = np.abs(occupancy - 0.5) > 1e-3
    np.testing.assert_array_equal(np.isinf(found)[clear], (occupancy > 0.5)[clear])
    free = np.isfinite(found)
    assert 0 < free.mean() < 1
    np.testing.assert_allclose(found[free], 10 * (cost - cost[free].min())[free], rtol=1e-3, atol=1e-3)


def test_the_shipped_network_is_small():
    assert load_costs().architecture.inputs == "both"
    assert sum(path.stat().st_size for path in resource("weights/cost_maps_indoors").rglob("*")) <= 8e6


def test_folders_without_a_network_of_this_kind_are_refused(weights, folder):
    card = folder / CARD
    facts = json.loads(card.read_text())
    assert facts["houses"] == "own"
    for changed, said in (({"classes": ["nothing"]}, "classes"), ({"cell_size": 0.05}, "cells of 0.05 m")):
        card.write_text(json.dumps(facts | changed))
        refusal(lambda: load_costs(folder), folder, said)
    write_network(folder, {name: weights[name] for name in list(weights)[1:]}, SMALL, COST_MAPS)
    refusal(lambda: load_costs(folder), folder / WEIGHTS, next(iter(weights)), "none")
    other = dataclasses.replace(SMALL, features=4)
    write_network(folder, fresh_weights(CostMapNetwork, other, jax.random.key(0)), other, COST_MAPS)
    refusal(lambda: load_costs(folder), folder, "5 features", "takes 4", "one folder")
    (folder / ENCODER_FOLDER / CARD).unlink()
    refusal(lambda: load_costs(folder), folder / ENCODER_FOLDER, "python -m experiments.objectnav_train")
