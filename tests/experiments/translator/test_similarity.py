"""Bags of visual words: a training map is at distance 0, one with nothing in common at 1."""

import numpy as np
import pytest

from dc2g_jax._src.grid.terrain import CLASS_NAMES, GRASS, HOUSE, ROAD
from experiments.translator.similarity import VOCABULARY, distance_to_training, patch_histograms, similarity_scale
from tests.support import maps

SHAPE = (64, 64)


def patchwork(seed: int) -> np.ndarray:
    """A map of small areas, four to a patch."""
    return np.kron(maps.random_terrain(seed, (32, 32), 0.5), np.ones((2, 2), np.uint8)).astype(np.uint8)


def test_histograms_count_the_classes_of_each_patch():
    terrain = np.full(SHAPE, GRASS, np.uint8)
    terrain[:4, 4:6] = ROAD
    found = patch_histograms(terrain)
    assert (found.shape, found.dtype) == ((256, len(CLASS_NAMES)), np.float32)
    np.testing.assert_allclose(found.sum(axis=1), 1)
    assert (found[1, GRASS], found[1, ROAD]) == (0.5, 0.5)
    assert (np.delete(found, 1, axis=0)[:, GRASS] == 1).all()


def test_distances_lie_between_training_maps_and_maps_of_other_words():
    training = np.stack([patchwork(seed) for seed in range(4)])
    scale = similarity_scale(training)
    assert scale.vocabulary.shape == (VOCABULARY, len(CLASS_NAMES))
    np.testing.assert_allclose(scale.bags.sum(axis=1), 1)
    for terrain in training:
        assert distance_to_training(terrain, scale) == 0
        assert distance_to_training(terrain[:, ::-1], scale) == 0  # the same words in other places
    other = distance_to_training(patchwork(9), scale)
    assert 0 < other < 1


def test_no_word_in_common():
    scale = similarity_scale(np.full((1, *SHAPE), GRASS, np.uint8))
    assert len(scale.vocabulary) == 1
    half = np.full(SHAPE, GRASS, np.uint8)
    half[32:] = HOUSE
    both = similarity_scale(np.stack([np.full(SHAPE, GRASS, np.uint8), half]))
    assert distance_to_training(np.full(SHAPE, HOUSE, np.uint8), both) == pytest.approx(0.5)
    grass_only = both._replace(bags=both.bags[:1])
    assert distance_to_training(np.full(SHAPE, HOUSE, np.uint8), grass_only) == pytest.approx(1)


def test_the_same_words_every_time():
    training = np.stack([patchwork(seed) for seed in range(3)])
    one, other = similarity_scale(training), similarity_scale(training)
    np.testing.assert_array_equal(one.vocabulary, other.vocabulary)


def test_a_map_that_cannot_be_broken_into_patches():
    with pytest.raises(ValueError, match="50 cells"):
        patch_histograms(np.zeros((50, 50), np.uint8))
