"""Maps of several houses in a row."""

import cv2
import numpy as np
import pytest

from dc2g_jax._src.grid.terrain import FRONT_DOOR, HOUSE
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import why_no_episode
from experiments.support.neighborhoods import draw_neighborhood


def blobs(cells: np.ndarray) -> int:
    """Connected parts of a set of cells, corners included."""
    return cv2.connectedComponents(cells.astype(np.uint8), connectivity=8)[0] - 1


@pytest.mark.parametrize("style", ["suburb_sidewalks", "compact_suburb", "large_lots"])
def test_houses_stand_in_rows_and_as_many_as_asked_for_have_a_door(style):
    one = draw_neighborhood(5, style, 200, 1)
    assert one.shape == (200, 200)
    assert one.dtype == np.uint8
    assert why_no_episode(House("one", "val", one)) is None
    assert blobs(one == HOUSE) >= 5
    # A house may have a second door.
    assert 1 <= blobs(one == FRONT_DOOR) <= 2
    assert blobs(draw_neighborhood(5, style, 200, 100) == FRONT_DOOR) > 2


def test_a_seed_gives_one_map():
    maps = [draw_neighborhood(seed, "compact_suburb", 64, 3) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(maps[0], maps[1])
    assert np.any(maps[0] != maps[2])


def test_what_cannot_be_drawn_is_refused():
    for arguments, reason in ((("urban", 200, 1), "no style is called"), (("large_lots", 49, 1), "cells 49:")):
        with pytest.raises(ValueError, match=reason):
            draw_neighborhood(0, *arguments)
    with pytest.raises(ValueError, match="doors 0:"):
        draw_neighborhood(0, "large_lots", 200, 0)
