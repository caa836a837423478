"""Grids sampled from class images; coarser grids, against plain loops."""

import math

import numpy as np
import pytest

from dc2g_jax._src.grid.sampling import sample_conservatively, sample_grid
from dc2g_jax._src.grid.terrain import FRONT_DOOR, GRASS, HOUSE, PATH, ROAD, TRAVERSABLE, UNKNOWN


@pytest.mark.parametrize("grid", [(23, 17), (7, 5), (22, 16), (1, 1), (23, 2)])
def test_no_obstacle_and_no_door_is_lost(grid):
    columns, rows = grid
    shares = {ROAD: 0.89, PATH: 0.08, FRONT_DOOR: 0.005, HOUSE: 0.005, GRASS: 0.01, UNKNOWN: 0.01}
    classes = np.random.default_rng(3).choice(list(shares), (17, 23), p=list(shares.values())).astype(np.uint8)
    found = sample_conservatively(classes, columns, rows)
    assert found.shape == (rows, columns)
    for row, column in np.ndindex(rows, columns):
        down, across = (
            slice(math.floor(cell * size / cells + 1e-9), math.ceil((cell + 1) * size / cells - 1e-9))
            for cell, size, cells in ((row, 17, rows), (column, 23, columns))
        )
        touched = classes[down, across].ravel().tolist()
        blocked = [each for each in touched if not TRAVERSABLE[each] and each != UNKNOWN]
        if FRONT_DOOR in touched:
            wanted = FRONT_DOOR
        elif blocked:
            wanted = max(sorted(set(blocked)), key=blocked.count)
        elif UNKNOWN in touched:
            wanted = UNKNOWN
        else:
            wanted = max(sorted(set(touched)), key=touched.count)
        assert found[row, column] == wanted


def test_sampling_to_columns_and_rows():
    classes = np.full((4, 6), GRASS, np.uint8)
    classes[2, 4] = HOUSE
    np.testing.assert_array_equal(sample_grid(classes, (3, 2)), [[GRASS, GRASS, GRASS], [GRASS, GRASS, HOUSE]])
    np.testing.assert_array_equal(sample_grid(classes[2:3, 4:], 1), [[HOUSE]])


def test_paths_are_widened_around_doors():
    classes = np.full((3, 4), GRASS, np.uint8)
    classes[1, 0], classes[0, 0] = PATH, FRONT_DOOR
    wanted = np.array([[FRONT_DOOR, PATH, GRASS, GRASS], [PATH, PATH, GRASS, GRASS], [PATH, PATH, GRASS, GRASS]])
    np.testing.assert_array_equal(sample_grid(classes, (4, 3)), wanted)


def test_what_has_no_cells_is_refused():
    with pytest.raises(ValueError, match="non-empty"):
        sample_grid(np.zeros((0, 5), np.uint8))


def test_a_map_of_one_class_stays_one():
    np.testing.assert_array_equal(sample_conservatively(np.full((4, 6), ROAD, np.uint8), 3, 2), np.full((2, 3), ROAD))
