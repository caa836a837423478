"""Towns drawn by hand: deterministic, with doors that can be reached, and sparse."""

import numpy as np
import pytest

from dc2g_jax._src.grid.ground import connected_to, pieces
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, GRASS, HOUSE, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.map_report import unlike_training
from dc2g_jax._src.readers.starts import sample_starts, why_no_episode
from dc2g_jax.families.town_drawing import TOWN_SIZES, draw_town


def test_there_are_a_hundred_towns_to_choose_on_and_a_hundred_aside():
    towns = open_dataset("towns")
    assert towns is open_dataset("towns")
    assert [len(towns.split(split)) for split in ("train", "val", "test")] == [0, 100, 100]
    assert {town.terrain.shape[::-1] for town in towns.split("test")} == set(TOWN_SIZES)
    assert len({town.terrain.tobytes() for town in towns.houses}) == 200


def test_every_door_can_be_reached_from_every_street():
    for town in open_dataset("towns").houses:
        terrain = town.terrain
        assert why_no_episode(town) is None
        assert connected_to(terrain == ROAD, TRAVERSABLE[terrain])[terrain == FRONT_DOOR].all()
        assert len(pieces(connected_to(terrain == FRONT_DOOR, TRAVERSABLE[terrain]))) == 1
        assert 1 <= len(pieces(terrain == FRONT_DOOR)) <= 3
        assert len(pieces(terrain == HOUSE)) >= 1
        sample_starts([town], 1, seed=0)


def test_a_town_depends_on_its_arguments_alone():
    once, again = draw_town(5, 90, 60), draw_town(5, 90, 60)
    np.testing.assert_array_equal(once, again)
    assert once.shape == (60, 90)
    assert not np.array_equal(once, draw_town(6, 90, 60))
    for wrong in ((-1, 90, 60), (0, 59, 60)):
        with pytest.raises(ValueError, match="give a seed of at least 0"):
            draw_town(*wrong)


def test_a_town_is_named_with_the_cells_to_try(street):
    town = np.full((200, 300), GRASS, np.uint8)
    town[50:60] = town[:, 150:158] = ROAD
    town_line, cells_line = unlike_training(town, (300, 200))
    assert "streets of 10 of 300 cells" in town_line
    assert "try --cells 150 100" in cells_line
    # Where streets are as wide as they should be, or a finer grid would need more pixels, there is nothing to try.
    assert len(unlike_training(town[::2, ::2], (300, 200))) == 1
    assert len(unlike_training(town[::5, ::5], (60, 40))) == 1
    assert len(unlike_training(town[::5, ::5], (300, 200))) == 2
    assert unlike_training(street, street.shape[::-1]) == []
    (no_road,) = unlike_training(np.where(town == ROAD, np.uint8(FREE), town), (300, 200))
    assert "no road" in no_road
