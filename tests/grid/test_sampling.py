"""Coarser grids, against plain loops."""

import math

import numpy as np
import pytest

from dc2g_jax.grid.sampling import sample_conservatively
from dc2g_jax.grid.terrain import FRONT_DOOR, GRASS, HOUSE, PATH, ROAD, TRAVERSABLE, UNKNOWN


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
