import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from dc2g_jax._src.grid.terrain import CLASS_NAMES, TRAVERSABLE
from dc2g_jax.robot.mapping.scene import LEAF_HEIGHT, SHAPES, TILES, Scene, scene_from_heights, scene_from_terrain
from tests.support.maps import drawn, random_cells, random_terrain, seeds

FRONT_DOOR, GRASS = CLASS_NAMES.index("front_door"), CLASS_NAMES.index("grass")
MIDDLE = TILES // 2


def heights_of(scene: Scene) -> np.ndarray:
    return np.maximum(np.asarray(scene.field), 0)


def in_cell(tiles: np.ndarray, row: int, column: int) -> np.ndarray:
    """The tiles of a cell."""
    return tiles[row * TILES : (row + 1) * TILES, column * TILES : (column + 1) * TILES]


@given(seed=seeds, density=st.sampled_from([0.0, 0.02, 0.2, 1.0]), shape=st.sampled_from([(1, 1), (1, 9), (7, 4)]))
def test_clearance_is_the_rings_of_ground_around_a_tile(seed, density, shape):
    blocked = random_cells(seed, shape, density)
    scene = scene_from_heights(np.where(blocked, 2.0, 0.0), np.full(shape, GRASS, np.uint8), 0.5)
    field = np.asarray(scene.field)
    places = np.argwhere(blocked)
    for row, column in np.ndindex(shape):
        if blocked[row, column]:
            assert field[row, column] == 2
        elif len(places):
            assert -field[row, column] == np.abs(places - (row, column)).max(axis=1).min() - 1
        else:
            # Nothing is near: at once past the border, wherever the ray goes.
            assert -field[row, column] >= max(shape) - 1


@given(seed=seeds)
def test_every_tile_has_the_class_of_its_cell(seed):
    terrain = random_terrain(seed, (3, 4), 0.5)
    classes = np.asarray(scene_from_terrain(terrain).classes)
    for row, column in np.ndindex(terrain.shape):
        assert np.all(in_cell(classes, row, column) == terrain[row, column])


@given(seed=seeds)
def test_ground_is_flat_but_for_door_leaves_and_cells_to_stand_on_are_free_in_the_middle(seed):
    terrain = random_terrain(seed, (6, 6), 0.5, doors=4)
    heights = heights_of(scene_from_terrain(terrain))
    for row, column in np.argwhere(TRAVERSABLE[terrain]):
        assert in_cell(heights, row, column)[MIDDLE, MIDDLE] == 0
        if terrain[row, column] != FRONT_DOOR:
            assert np.all(in_cell(heights, row, column) == 0)


def test_a_front_door_has_a_leaf_along_the_house_it_touches():
    heights = heights_of(scene_from_terrain(drawn("###. #DD. .PPD ....")))
    leaf = np.zeros((TILES, TILES), bool)
    leaf[0, :], leaf[:-1, 0] = True, True
    np.testing.assert_array_equal(in_cell(heights, 1, 1), np.where(leaf, np.float32(LEAF_HEIGHT), 0))
    # The house ends above the second door cell, so the leaf does one tile before.
    leaf[:, 0], leaf[0, -1] = False, False
    leaf[0, 0] = True
    np.testing.assert_array_equal(in_cell(heights, 1, 2), np.where(leaf, np.float32(LEAF_HEIGHT), 0))
    # This one touches no house.
    assert np.all(in_cell(heights, 2, 3) == 0)
    # Between leaf and wall the house has no flat tile.
    assert in_cell(heights, 1, 0)[:4, -1].tolist() == [np.float32(LEAF_HEIGHT)] * 4
    assert np.all(in_cell(heights, 1, 0)[:3, -2] >= 3)


def test_a_house_has_walls_and_a_roof_that_rises_to_its_middle():
    terrain = np.full((9, 9), GRASS, np.uint8)
    terrain[1:8, 1:8] = CLASS_NAMES.index("house")
    heights = heights_of(scene_from_terrain(terrain, cell_size=1.0))
    profile = heights[4 * TILES + MIDDLE, TILES : 4 * TILES + MIDDLE + 1]
    assert profile[:3].tolist() == pytest.approx([0, 3.0, 3.1])
    assert np.all(np.diff(profile[1:]) == pytest.approx(0.1, abs=1e-5))
    # Twice as large a cell, twice as broad a house, the same slope: it ends at the top.
    large = heights_of(scene_from_terrain(terrain, cell_size=2.0))
    assert large.max() == pytest.approx(SHAPES["house"].top)
    assert float(scene_from_terrain(terrain, cell_size=2.0).ceiling) == large.max()


def test_a_house_that_the_map_cuts_off_goes_on():
    heights = heights_of(scene_from_terrain(drawn("### ### ###")))
    assert heights.min() == heights.max() > SHAPES["house"].rings[0]


@pytest.mark.parametrize("name", SHAPES)
def test_an_obstacle_stands_one_tile_inside_its_cell(name):
    terrain = np.full((3, 3), GRASS, np.uint8)
    terrain[1, 1] = CLASS_NAMES.index(name)
    cell = in_cell(heights_of(scene_from_terrain(terrain)), 1, 1)
    rim = np.ones((TILES, TILES), bool)
    rim[1:-1, 1:-1] = False
    assert np.all(cell[rim] == 0)
    assert cell[MIDDLE, MIDDLE] == cell.max() > 0.7


def test_a_garage_door_is_part_of_the_house():
    garage = CLASS_NAMES.index("garage door")
    with_garage = np.array([[2, 7, 7, 2], [2, garage, 7, 2], [2, 4, 2, 2]], np.uint8)
    plain = np.where(with_garage == garage, CLASS_NAMES.index("house"), with_garage).astype(np.uint8)
    np.testing.assert_array_equal(scene_from_terrain(with_garage).field, scene_from_terrain(plain).field)


def test_scenes_can_be_stacked():
    scenes = [scene_from_terrain(drawn(picture), size) for picture, size in (("#. ..", 1.0), (".. tR", 0.5))]
    for scene, size in zip(scenes, (0.2, 0.1), strict=True):
        assert scene.field.shape == scene.classes.shape == (10, 10)
        assert scene.field.dtype == scene.tile_size.dtype == scene.ceiling.dtype == jnp.float32
        assert float(scene.tile_size) == pytest.approx(size)
