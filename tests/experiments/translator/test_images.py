"""Pictures of maps and of cost-to-go: what they show can be read back, and colors are judged as OpenCV does."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from dc2g_jax._src.files.class_images import read_class_image, read_palette, write_class_image
from dc2g_jax._src.grid.search import cost_to_go
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, ROAD, TRAVERSABLE
from experiments.translator import images
from tests.support import maps
from tests.support.places import PUBLISHED

SHAPE = (9, 12)


@jax.jit
def to_image(cost, observed):
    return images.cost_to_go_image(cost, observed, images.largest_cost(cost))


read_back = jax.jit(images.read_cost_to_go)
solve = jax.jit(cost_to_go)


def random_house(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A whole map, its cost-to-go, and what of the map is observed."""
    terrain = maps.random_terrain(seed, SHAPE, 0.7)
    cost = np.asarray(solve(TRAVERSABLE[terrain], terrain == FRONT_DOOR))
    return terrain, cost, np.where(maps.random_cells(seed, SHAPE, 0.6), terrain, 0).astype(np.uint8)


def oracle_image(cost: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Pixel by pixel, as the paper words it."""
    largest = max((value for value in cost.ravel() if np.isfinite(value)), default=0.0) or 1.0
    gray = np.zeros(SHAPE)
    for place in np.ndindex(SHAPE):
        if TRAVERSABLE[observed[place]] and np.isfinite(cost[place]):
            gray[place] = 1 - cost[place] / largest
    if gray.max() > 0:
        gray /= gray.max()
    image = np.repeat(gray[..., None], 3, axis=2)
    image[(observed != 0) & ~TRAVERSABLE[observed]] = (1, 0, 0)
    return image


@given(maps.seeds)
def test_a_cost_to_go_image_is_that_of_the_paper(seed):
    _, cost, observed = random_house(seed)
    np.testing.assert_allclose(to_image(cost, observed), oracle_image(cost, observed), atol=1e-6)


@given(maps.seeds)
def test_what_an_image_shows_is_read_back(seed):
    _, cost, observed = random_house(seed)
    image = to_image(cost, observed)
    read = read_back(image, observed)
    gray = oracle_image(cost, observed)[..., 2]
    np.testing.assert_allclose(read, 1 - gray, atol=1e-6)
    # Where something near and something far are both visible, the order of costs is that of the map.
    shown = np.isfinite(cost) & TRAVERSABLE[observed]
    if shown.any():
        assert np.asarray(read)[shown].min() == pytest.approx(0.0 if gray.max() else 1.0, abs=1e-6)
        assert cost[shown][np.argmin(np.asarray(read)[shown])] == pytest.approx(cost[shown].min(), abs=1e-4)


@pytest.mark.parametrize("observed", [np.zeros(SHAPE, np.uint8), np.full(SHAPE, CLASS_NAMES.index("grass"), np.uint8)])
def test_maps_that_show_no_road_are_black_and_red(observed):
    image = to_image(np.full(SHAPE, np.inf, np.float32), observed)
    np.testing.assert_array_equal(image, np.broadcast_to((float(observed.any()), 0, 0), (*SHAPE, 3)))
    np.testing.assert_array_equal(read_back(image, observed), np.ones(SHAPE))


@given(st.integers(0, 2**32 - 1))
def test_saturation_and_brightness_are_those_of_opencv(seed):
    rng = np.random.default_rng(seed)
    image = rng.random((8, 9, 3), dtype=np.float32)
    image[0], image[1] = 0, image[1, :, :1]
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
    np.testing.assert_allclose(jax.jit(images.saturation)(image), hsv[..., 1], atol=1e-5)
    np.testing.assert_allclose(jax.jit(images.brightness)(image), hsv[..., 2], atol=1e-6)
    clear = np.abs(hsv[..., 1] - images.SATURATION_LIMIT) > 1e-4
    np.testing.assert_array_equal(
        np.asarray(jax.jit(images.looks_traversable)(image))[clear], (hsv[..., 1] < images.SATURATION_LIMIT)[clear]
    )


@given(st.integers(0, 2**32 - 1))
def test_eight_bits_hold_what_a_file_of_bytes_does(seed):
    picture = np.random.default_rng(seed).uniform(-0.1, 1.1, (20, 30, 3)).astype(np.float32)
    stored = np.clip(picture * np.float32(255.5), 0, 255).astype(np.uint8)
    np.testing.assert_allclose(images.in_eight_bits(jnp.asarray(picture)), stored / 255, atol=1e-6)
    kept = jnp.asarray(stored / np.float32(255))
    np.testing.assert_allclose(images.in_eight_bits(kept), kept, atol=1e-6)


def test_nearly_black_is_black():
    picture = images.in_eight_bits(jnp.asarray([[[0.003, 0.0, 0.001]]]))
    assert np.all(np.asarray(picture) == 0)
    assert images.looks_traversable(picture).all()


def test_the_map_tells_what_is_traversable_and_redness_does_not_count():
    image = np.array([[(1, 1, 1), (0.5, 0.5, 0.5), (1, 0, 0), (0.8, 0.2, 0.2), (0.8, 0.7, 0.7), (1, 1, 1)]], np.float32)
    observed = np.array([[ROAD] * 5 + [CLASS_NAMES.index("grass")]], np.uint8)
    np.testing.assert_allclose(read_back(image, observed), [[0, 0.5, 1, 0.8, 0.3, 1]], atol=1e-6)


def test_a_semantic_image_has_the_colors_of_the_published_palette(shared, tmp_path):
    terrain = maps.random_terrain(0, SHAPE, 0.5)
    picture = np.asarray(images.semantic_image(jnp.asarray(terrain)))
    write_class_image(tmp_path / "map.png", terrain)
    np.testing.assert_array_equal((picture * 255).round(), cv2.imread(str(tmp_path / "map.png"))[..., ::-1])
    read = read_class_image(tmp_path / "map.png", read_palette(PUBLISHED / "labels_colors.csv"))
    np.testing.assert_array_equal(read, terrain)


def test_many_images_at_once():
    houses = [random_house(seed) for seed in range(4)]
    cost, observed = np.stack([house[1] for house in houses]), np.stack([house[2] for house in houses])
    together = jax.vmap(to_image)(cost, observed)
    alone = [to_image(*pair) for pair in zip(cost, observed, strict=True)]
    np.testing.assert_allclose(together, alone, atol=1e-6)
