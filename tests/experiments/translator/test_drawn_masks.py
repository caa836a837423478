"""Drawn observation masks: reproducible, neither empty nor full, and complete in their variants."""

import numpy as np
import pytest

from experiments.translator.drawn_masks import VARIANTS, drawn_masks, mask_variants


def test_a_mask_has_eight_variants():
    mask = np.zeros((6, 6), bool)
    mask[0, 1:3] = mask[2, 4] = True
    variants = mask_variants(mask)
    assert variants.shape == (VARIANTS, 6, 6)
    assert len({variant.tobytes() for variant in variants}) == VARIANTS
    np.testing.assert_array_equal(variants[4:], ~variants[:4])
    np.testing.assert_array_equal(variants[0], mask)
    assert {variant.sum() for variant in variants[:4]} == {mask.sum()}


@pytest.mark.parametrize("size", [32, 100])
def test_drawings_cover_some_of_the_map_and_differ(size):
    masks = drawn_masks(10 * VARIANTS, size, seed=3)
    assert (masks.shape, masks.dtype) == ((10 * VARIANTS, size, size), bool)
    share = masks.mean(axis=(1, 2))
    assert 0.1 <= share.min() < 0.4 < 0.6 < share.max() <= 0.9
    assert len({mask.tobytes() for mask in masks}) > 9.5 * VARIANTS
    # Shapes, not noise: hardly any cell differs from the one beside it.
    assert np.mean(masks[:, 1:] != masks[:, :-1]) < 0.1


def test_masks_depend_on_the_seed_alone():
    np.testing.assert_array_equal(drawn_masks(15, 32, seed=1), drawn_masks(32, 32, seed=1)[:15])
    assert not np.array_equal(drawn_masks(15, 32, seed=1), drawn_masks(15, 32, seed=2))
