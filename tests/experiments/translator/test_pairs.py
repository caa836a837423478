"""Pairs of pictures: labels as the authors', masks that only hide, and every pair once an epoch."""

import functools

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.sampling import resize_nearest, sample_grid
from dc2g_jax._src.grid.terrain import FRONT_DOOR, GRASS, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import House, HouseDataset, load_dataset
from dc2g_jax._src.runtime.errors import InputError
from experiments.translator.drawn_masks import drawn_masks
from experiments.translator.images import cost_to_go_image, largest_cost
from experiments.translator.pairs import (
    all_pairs,
    draw_image_pairs,
    houses_with_door,
    image_set,
    labeled_grid,
    labeled_map,
    masked_map,
)
from tests.support import maps
from tests.support.places import PUBLISHED

make_pairs = jax.jit(jax.vmap(lambda data, index: masked_map(data, index).pictures(), in_axes=(None, 0)))


def dijkstra_oracle(terrain: np.ndarray) -> np.ndarray:
    """8-connected cost to the nearest door over traversable cells, by SciPy."""
    cells = [tuple(int(v) for v in cell) for cell in np.argwhere(TRAVERSABLE[terrain])]
    number = {cell: place for place, cell in enumerate(cells)}
    edges = [
        (number[row, column], number[row + dy, column + dx], float(np.hypot(dx, dy)))
        for row, column in cells
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
        if (dx or dy) and (row + dy, column + dx) in number
    ]
    start, end, length = zip(*edges, strict=True)
    graph = coo_array((length, (start, end)), shape=(len(cells), len(cells))).tocsr()
    doors = [number[cell] for cell in cells if terrain[cell] == FRONT_DOOR]
    cost = np.full(terrain.shape, np.inf)
    cost[tuple(np.array(cells).T)] = dijkstra(graph, indices=doors, min_only=True)
    return cost


def test_labels_are_exact():
    terrain = maps.random_terrain(5, (32, 32), 0.7, doors=2)
    same, cost = labeled_map(terrain, 32)
    np.testing.assert_array_equal(same, terrain)
    np.testing.assert_allclose(cost, dijkstra_oracle(terrain), rtol=1e-5)
    grid, cost = labeled_grid(terrain, 20)
    np.testing.assert_array_equal(grid, sample_grid(terrain, 20))
    np.testing.assert_allclose(cost, dijkstra_oracle(grid), rtol=1e-5)


def test_distances_are_those_of_the_map_in_its_own_proportions():
    image = np.full((16, 64), ROAD, np.uint8)
    image[:, 0] = FRONT_DOOR
    terrain, cost = labeled_map(image, 32)
    assert terrain.shape == cost.shape == (32, 32)
    # 32 pixels along the longer side: half the image's; rows are stretched and no farther apart for it.
    np.testing.assert_array_equal(cost, np.tile(np.arange(32.0), (32, 1)))


def test_labels_agree_with_the_authors_images(shared):
    del shared
    houses = load_dataset(PUBLISHED, cells=None).split("val")
    for house in houses:
        path = PUBLISHED / "full_c2g" / house.split / f"world{house.name}-front_door.png"
        theirs = resize_nearest(cv2.imread(str(path))[..., ::-1], 256, 256) / 255.0
        terrain, cost = labeled_map(house.terrain, 256)
        ours = np.asarray(cost_to_go_image(jnp.asarray(cost), jnp.asarray(terrain), largest_cost(jnp.asarray(cost))))
        red, our_red = (image[..., 0] > image[..., 1] + 0.5 for image in (theirs, ours))
        assert np.mean(red == our_red) > 0.98
        # Their search overestimates slightly.
        difference = np.abs(theirs - ours)[~red & ~our_red]
        assert difference.mean() < 0.01
        assert np.quantile(difference, 0.99) < 0.06


def some_houses() -> list[House]:
    return [House(f"h{seed}", "train", maps.random_terrain(seed, (40, 32), 0.85)) for seed in range(3)]


def test_a_mask_only_hides():
    houses, masks = some_houses(), drawn_masks(4, 32, seed=0)
    data = all_pairs(houses, masks)
    assert len(data.pair_house) == 12
    pairs = make_pairs(data, jnp.arange(12))
    whole = make_pairs(all_pairs(houses, np.ones((1, 32, 32), bool)), jnp.arange(3))
    for index in range(12):
        seen, house = masks[index % 4], index // 4
        expected = np.where(seen[..., None], whole.image[house], 0)
        np.testing.assert_array_equal(pairs.image[index], expected)
        red = np.asarray(pairs.target[index])[..., 0] != np.asarray(pairs.target[index])[..., 1]
        np.testing.assert_array_equal(red, seen & ~TRAVERSABLE[np.asarray(data.terrain[house])])
        # Grays are those of the whole map, brightened alike.
        ours, full = np.asarray(pairs.target[index])[..., 2], np.asarray(whole.target[house])[..., 2] * seen
        np.testing.assert_allclose(ours * full.max(), full, atol=1e-5)


def test_an_epoch_has_every_pair_once():
    data = all_pairs(some_houses(), drawn_masks(4, 32, seed=0))
    draw = jax.jit(functools.partial(draw_image_pairs, batch_size=2, whole_share=0.0, augment=False))
    every = {np.asarray(image).tobytes() for image in make_pairs(data, jnp.arange(12)).image}
    epochs = []
    for epoch in range(2):
        batches = [draw(jax.random.key(0), jnp.int32(6 * epoch + step), data).image for step in range(6)]
        epochs.append([np.asarray(image).tobytes() for batch in batches for image in batch])
        assert set(epochs[-1]) == every
    assert epochs[0] != epochs[1]
    again = draw(jax.random.key(0), jnp.int32(7), data).image
    assert [np.asarray(image).tobytes() for image in again] == epochs[1][2:4]


def test_a_share_of_pairs_is_whole():
    data = all_pairs(some_houses(), drawn_masks(16, 32, seed=0))
    draw = jax.jit(functools.partial(draw_image_pairs, batch_size=48, whole_share=0.25, augment=False))
    images = np.concatenate([draw(jax.random.key(0), jnp.int32(step), data).image for step in range(10)])
    whole = (images.any(axis=-1)).all(axis=(1, 2))
    assert 0.18 < whole.mean() < 0.32
    assert len({image.tobytes() for image in images[whole]}) == 3


def test_augmented_maps_are_larger_pieces_of_the_old_ones():
    data = all_pairs(some_houses()[:1], np.ones((1, 64, 64), bool))
    draw = jax.jit(functools.partial(draw_image_pairs, batch_size=64, whole_share=0.0, augment=True))
    batch, whole = draw(jax.random.key(0), jnp.int32(0), data), make_pairs(data, jnp.arange(1))
    enlarged = [np.asarray(resize_nearest(picture[0], 72, 72)) for picture in (whole.image, whole.target)]
    found = set()
    turns = [(quarters, mirrored) for quarters in range(4) for mirrored in (False, True)]

    def piece(picture, top, left, quarters, mirrored):
        turned = np.rot90(picture[top : top + 64, left : left + 64], quarters)
        return turned[:, ::-1] if mirrored else turned

    for image, target in zip(np.asarray(batch.image), np.asarray(batch.target), strict=True):
        places = [(top, left, *turn) for top in range(9) for left in range(9) for turn in turns]
        (place,) = [place for place in places if np.array_equal(image, piece(enlarged[0], *place))]
        found.add(place)
        gray = piece(enlarged[1], *place)
        red = gray[..., 0] != gray[..., 1]
        np.testing.assert_array_equal(target[..., 0] != target[..., 1], red)
        # The nearest cell that is left is white, and grays are brightened alike.
        brightest = np.where(red, 0, gray[..., 2]).max()
        np.testing.assert_allclose(target[..., 2] * brightest, gray[..., 2], atol=1e-5)
    assert len(found) > 40
    assert {place[2:] for place in found} == set(turns)


@pytest.mark.parametrize("size", [16, 50])
def test_masks_may_have_another_resolution(size):
    data = all_pairs(some_houses(), np.ones((1, 32, 32), bool))
    coarse = maps.random_cells(0, (size, size), 0.5)
    data = data.replace(masks=bitboard.pack(jnp.asarray(coarse))[None])
    image = make_pairs(data, jnp.arange(1)).image[0]
    seen = resize_nearest(coarse, 32, 32) & (np.asarray(data.terrain[0]) != 0)
    np.testing.assert_array_equal(np.asarray(image).any(axis=-1), seen)


def test_houses_without_a_door_are_left_out_and_a_split_without_houses_is_refused():
    doorless = House("n0", "val", np.full((40, 40), GRASS, np.uint8))
    dataset = HouseDataset("some", "folder", (*some_houses(), doorless))
    assert [house.name for house in houses_with_door(dataset, "train")] == ["h0", "h1", "h2"]
    for split in ("val", "test"):
        with pytest.raises(InputError, match=f"some: no {split} house has a front door"):
            houses_with_door(dataset, split)


@pytest.mark.slow
def test_masks_of_robots():
    data = image_set(maps.drawn_dataset(), "train", size=32, masks="rollout", per_house=6)
    np.testing.assert_array_equal(data.pair_house, np.repeat([0, 1], 6))
    assert data.masks.shape == (12, 2, 50)
    share = [np.asarray(bitboard.unpack(mask, 50)).mean() for mask in data.masks]
    assert 0 < min(share) < max(share) < 1
    again = image_set(maps.drawn_dataset(), "train", size=32, masks="rollout", per_house=6)
    np.testing.assert_array_equal(again.masks, data.masks)


def test_no_masks_make_no_pairs():
    with pytest.raises(InputError, match="masks per house 0"):
        image_set(maps.drawn_dataset(), "train", size=32, masks="paper", per_house=0)
