"""What hangs together: against plain floods, and on maps drawn by hand."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from dc2g_jax._src.grid.ground import (
    Piece,
    component_numbers,
    connected_to_goal,
    goals_without_ground,
    longest_way,
    pieces,
    why_no_path,
)
from dc2g_jax._src.grid.sampling import sample_grid
from dc2g_jax._src.grid.terrain import FRONT_DOOR, PATH, TRAVERSABLE
from dc2g_jax._src.readers.houses import load_dataset
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps
from tests.support.places import PUBLISHED


def test_connected_to_goal(street, island):
    for terrain in (street, island, *(maps.random_terrain(seed, (9, 31), 0.6, doors=2) for seed in range(10))):
        free, wanted = np.isin(terrain, oracle.TRAVERSABLE_CLASSES), np.zeros(terrain.shape, bool)
        for y, x in np.argwhere(terrain == FRONT_DOOR):
            wanted |= oracle.reachable(free, int(x), int(y))
        np.testing.assert_array_equal(connected_to_goal(terrain), wanted)


def test_pieces_touch_by_their_sides_and_come_in_order_of_size():
    cells = np.array([[1, 0, 0, 1], [0, 1, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], bool)
    assert pieces(cells) == [Piece(1, 1, 3), Piece(0, 0, 1), Piece(3, 0, 1), Piece(3, 3, 1)]
    assert pieces(np.zeros((3, 2), bool)) == []
    assert pieces(np.ones((3, 2), bool)) == [Piece(0, 1, 6)]
    assert pieces(np.ones((1, 5), bool)) == [Piece(2, 0, 5)]
    assert pieces(np.ones((5, 1), bool)) == [Piece(0, 2, 5)]


def test_goals_without_ground():
    terrain = maps.drawn("""
        DD..
        ....
        RD.D
        ..RR
    """)
    assert np.argwhere(goals_without_ground(terrain)).tolist() == [[0, 0], [0, 1]]


@pytest.mark.parametrize(
    ("picture", "reason"),
    [
        ("RD", None),
        ("D. .R", "no front door can be reached, none touches other traversable ground"),
        ("RR", "it has no front door"),
        ("..", "it has no traversable ground"),
        ("DD", "it has no traversable ground"),
    ],
)
def test_why_no_path(picture, reason):
    assert why_no_path(maps.drawn(picture)) == reason


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="../shared is absent")
def test_grids_and_components_of_real_houses_are_those_of_opencv():
    for house in load_dataset(PUBLISHED).houses:
        cells = TRAVERSABLE[house.terrain]
        _, numbers = cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)
        np.testing.assert_array_equal(component_numbers(cells), numbers)
        paths = cv2.dilate((house.terrain == PATH).astype(np.uint8), np.ones((3, 3), np.uint8)) == 1
        wanted = np.where(paths & (house.terrain != FRONT_DOOR), PATH, house.terrain)
        np.testing.assert_array_equal(sample_grid(house.terrain, house.terrain.shape[::-1]), wanted)


def test_the_longest_way(street, island, buried):
    for terrain in (street, island, buried, *(maps.random_terrain(seed, (9, 31), 0.7, doors=2) for seed in range(10))):
        connected = connected_to_goal(terrain)
        reached = [connected & (terrain == FRONT_DOOR)]
        while not np.array_equal(reached[-1], connected):
            reached.append(ndimage.binary_dilation(reached[-1], mask=connected))
        assert longest_way(terrain) == len(reached) - 1
