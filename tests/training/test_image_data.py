"""The translator's training pairs: masks of robots, and requests that make none."""

import numpy as np
import pytest

from dc2g_jax.errors import InputError
from dc2g_jax.grid import bitboard
from dc2g_jax.training.image_data import image_set
from tests.support import maps


def test_masks_of_robots():
    data = image_set(maps.drawn_dataset(), "train", size=32, masks="rollout", per_house=6)
    np.testing.assert_array_equal(data.pair_house, np.repeat([0, 1], 6))
    assert data.masks.shape == (12, 2, 50)
    share = [np.asarray(bitboard.unpack(mask, 50)).mean() for mask in data.masks]
    assert 0 < min(share) < max(share) < 1
    again = image_set(maps.drawn_dataset(), "train", size=32, masks="rollout", per_house=6)
    np.testing.assert_array_equal(again.masks, data.masks)


def test_no_masks_make_no_pairs():
    with pytest.raises(InputError, match="train: 0 masks a house"):
        image_set(maps.drawn_dataset(), "train", size=32, masks="paper", per_house=0)
