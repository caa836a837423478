"""Remixed houses can be run in, are made of what they are given alone, and are the same for a seed."""

import numpy as np
import pytest

from dc2g_jax.datasets import remixing
from dc2g_jax.datasets.houses import House
from dc2g_jax.datasets.remixing import remix, remixed_houses
from dc2g_jax.datasets.starts import start_cells, why_no_episode
from dc2g_jax.grid.terrain import FRONT_DOOR, GRASS, ROAD
from dc2g_jax.training_data import drawn_houses


@pytest.fixture(scope="module")
def houses() -> list[House]:
    return drawn_houses("e", "train", 6, seed=0, cells=50)


@pytest.fixture(scope="module")
def remixed(houses) -> list[House]:
    return remixed_houses(houses, 60, seed=3)


def test_an_episode_can_be_run_in_every_one(houses, remixed):
    fewest = min(np.count_nonzero(start_cells(house.terrain)) for house in houses)
    for house in remixed:
        assert why_no_episode(house) is None
        assert 4 * np.count_nonzero(start_cells(house.terrain)) >= fewest
        assert house.split == "train"
        assert house.terrain.shape == houses[0].terrain.shape
        assert house.terrain.dtype == np.uint8


def test_each_is_another_and_known_houses_are_not_among_them(houses, remixed):
    kinds = {house.terrain.tobytes() for house in remixed}
    assert len(kinds) == len(remixed)
    assert not kinds & {house.terrain.tobytes() for house in houses}


def test_the_first_ones_depend_on_the_seed_alone(houses, remixed):
    for house, again in zip(remixed, remixed_houses(houses, 3, seed=3), strict=False):
        assert house.name == again.name
        np.testing.assert_array_equal(house.terrain, again.terrain)
    assert not np.array_equal(remixed[0].terrain, remixed_houses(houses, 1, seed=4)[0].terrain)


def test_classes_are_those_of_the_houses(houses, remixed):
    known = set(np.unique([house.terrain for house in houses]))
    assert set(np.unique([house.terrain for house in remixed])) <= known


def test_a_piece_goes_on_where_the_cut_is():
    """Of maps that are a road across grass, all that can be joined are roads that meet."""
    rng = np.random.default_rng(0)
    maps = np.full((2, 40, 40), GRASS, np.uint8)
    maps[0, 10:14], maps[1, 22:26] = ROAD, ROAD
    joined = remixing._joined(rng, maps[0], maps[1])
    assert joined is not None
    np.testing.assert_array_equal(joined == ROAD, maps[0] == ROAD)
    assert remixing._joined(rng, maps[0], np.full((40, 40), FRONT_DOOR, np.uint8)) is None


def test_narrow_maps():
    lane = House("lane", "train", np.array([[ROAD, ROAD, FRONT_DOOR]] * 4, np.uint8).T)
    for house in remixed_houses([lane, lane], 8, seed=0):
        assert why_no_episode(house) is None


def test_oblong_maps_and_maps_without_a_chance(street):
    oblong = House("oblong", "train", street)
    assert all(house.terrain.shape == street.shape for house in remixed_houses([oblong], 8, seed=0))
    # One way to the door, a cell wide: whatever is changed blocks it.
    maze = np.full((9, 9), GRASS, np.uint8)
    maze[::2] = ROAD
    maze[1::4, 8] = maze[3::4, 0] = ROAD
    maze[8, 8] = FRONT_DOOR
    lucky = remix(np.random.default_rng(0), [House("maze", "train", maze)])
    assert why_no_episode(House("", "train", lucky)) is None
