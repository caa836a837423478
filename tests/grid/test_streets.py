"""What tells a town from a house with its surroundings, square by square."""

import jax
import numpy as np
import pytest

from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.streets import in_town, is_town, street_width
from dc2g_jax._src.grid.terrain import GRASS, ROAD, UNKNOWN
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax.families import procedural_dataset

SHAPES = ((34, 75), (34, 104))


def narrow_road(terrain: np.ndarray) -> bool:
    """Whether less than half of the observed road is in squares of road, a twelfth of the map wide.

    Squares may extend beyond the right and the lower edge, and into what is unobserved on maps of up to 100 cells.
    """
    side = max(terrain.shape) // 12
    passable = [ROAD, UNKNOWN] if max(terrain.shape) <= 100 else [ROAD]
    maybe = np.pad(np.isin(terrain, passable), ((0, side), (0, side)), constant_values=True)
    wide = np.zeros_like(maybe)
    for row in range(terrain.shape[0]):
        for column in range(terrain.shape[1]):
            square = slice(row, row + side), slice(column, column + side)
            if maybe[square].all():
                wide[square] = True
    road = terrain == ROAD
    return bool(2 * np.sum(wide[: road.shape[0], : road.shape[1]] & road) < np.sum(road))


def random_streets(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """A partly observed map with streets of random widths."""
    rng = np.random.default_rng(seed)
    terrain = np.full(shape, GRASS, np.uint8)
    for _ in range(rng.integers(0, 4)):
        begin, width = rng.integers(0, 30), rng.integers(1, 10)
        terrain[(slice(begin, begin + width), slice(None))[:: rng.choice([1, -1])]] = ROAD
    rows, columns = np.indices(shape)
    far = (rows - rng.integers(34)) ** 2 + (columns - rng.integers(75)) ** 2 > rng.integers(5, 60) ** 2
    return np.where(far, np.uint8(UNKNOWN), terrain)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_robot_is_in_a_town_if_most_of_the_road_that_it_has_seen_is_narrow(shape):
    terrains = [random_streets(seed, shape) for seed in range(60)]
    told = jax.jit(lambda seen: in_town(belief_from_map(seen, make_pose(0, 0, 0))))
    wanted = [narrow_road(terrain) for terrain in terrains]
    assert [bool(told(terrain)) for terrain in terrains] == wanted
    assert 10 < sum(wanted) < 50


@pytest.mark.parametrize("width", [0, 1, 4, 9])
def test_the_width_of_streets_is_that_of_the_widest(width):
    terrain = np.full(SHAPES[0], GRASS, np.uint8)
    terrain[3 : 3 + width] = ROAD
    terrain[:, 60 : 60 + width // 2] = ROAD
    assert street_width(terrain) == width
    assert is_town(terrain) == (0 < width < 75 // 12)


def test_houses_are_no_towns_and_most_drawn_towns_are():
    assert not any(is_town(house.terrain) for house in procedural_dataset().houses)
    towns = open_dataset("towns").split("val")
    assert sum(is_town(town.terrain) for town in towns) > 0.8 * len(towns)
