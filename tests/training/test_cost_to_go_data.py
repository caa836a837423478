"""What training is given: bad requests are refused by name, labels and masks belong together."""

import numpy as np
import pytest

from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.grid.terrain import FRONT_DOOR, ROAD
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training.cost_to_go_data import (
    DataConfig,
    check_houses,
    check_masks,
    observation_masks,
    training_houses,
    training_set,
)
from dc2g_jax._src.training.masks import Masks
from tests.support.refusals import refusal


def masks(**changes) -> Masks:
    whole = {"boards": np.ones((4, 1, 8), np.uint32), "world": np.array([0, 0, 1, 1], np.int32)}
    return Masks(**{**whole, **changes})


@pytest.fixture
def houses(street) -> list[House]:
    return [House(f"h{index}", "train", street) for index in range(2)]


@pytest.mark.parametrize(
    ("options", "mention"),
    [
        ({"data_seed": 10_000}, "10000; give|data seed 10000"),
        ({"ranges": ()}, "sensing ranges"),
        ({"ranges": (0, 5)}, "sensing range 0"),
        ({"ranges": (5, 65)}, "from 1 to 64 cells"),
        ({"field_of_view": 0.5}, "field of view 0.5: give a number from 1 to 360"),
        ({"masks_per_episode": 0}, "masks_per_episode 0"),
        ({"extra_houses": -1}, "extra_houses -1"),
        ({"half_weight_cost": 0.0}, "half_weight_cost 0.0"),
    ],
)
def test_data_that_cannot_be_made_is_refused(options, mention):
    with pytest.raises(InputError, match=mention):
        DataConfig(**options)


def test_houses_in_which_nothing_is_to_be_looked_for_are_refused():
    tiny = House("tiny", "train", np.pad(np.full((1, 1), ROAD, np.uint8), 1, constant_values=FRONT_DOOR))
    config = DataConfig(extra_houses=0, starts_per_house=1, ranges=(12,))
    refusal(lambda: observation_masks(config, [tiny], 1, lambda done, total: None), "no mask", "larger houses")


def test_houses_that_drawn_ones_cannot_stand_beside_are_refused(street):
    config = DataConfig(extra_houses=2)
    own = House("e00001", "train", street[:, :8])
    refusal(lambda: training_houses(HouseDataset("mine", "folder", (own,)), config), "e00001", "rename")
    oblong = House("long", "train", street)
    mine = HouseDataset("mine", "folder", (oblong,))
    refusal(lambda: training_houses(mine, config), "long", "square", "--extra-houses 0")
    refusal(lambda: check_houses(mine, extra=2, drawn=False, validated=False), "long", "square", "--extra-houses 0")
    assert training_houses(mine, DataConfig(extra_houses=0)) == ([oblong], 1)


def test_masks_of_other_maps_are_refused(houses):
    height = houses[0].terrain.shape[0]
    good = masks(boards=np.ones((4, 1, height), np.uint32))
    check_masks(good, houses, "masks.safetensors")
    for bad in (
        good._replace(boards=good.boards[:, :, 1:]),
        good._replace(boards=good.boards[:, 0]),
        good._replace(boards=good.boards.astype(np.int64)),
        good._replace(world=np.array([0, 0, 1, 2])),
        good._replace(world=good.world[:3]),
    ):
        with pytest.raises(InputError, match=r"masks\.safetensors: masks of .*; delete the file"):
            check_masks(bad, houses, "masks.safetensors")


def test_labels_are_those_of_each_house(houses, street):
    height = street.shape[0]
    other = House("other", "train", np.ascontiguousarray(street[:, ::-1]))
    data = training_set(
        [*houses, other], 2, masks(boards=np.ones((4, 1, height), np.uint32), world=np.array([0, 1, 2, 2]))
    )
    assert int(data.n_own) == 2
    np.testing.assert_array_equal(data.cost_to_go[0], world_cost_to_go(World.from_terrain(street)))
    np.testing.assert_array_equal(data.cost_to_go[2], np.asarray(data.cost_to_go[0])[:, ::-1])
    np.testing.assert_array_equal(data.terrain[2], other.terrain)
