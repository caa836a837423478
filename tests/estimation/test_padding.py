"""The network on a grid larger than the map answers as it does to the map alone."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.padding import PaddedNetwork
from dc2g_jax._src.grid.terrain import OUTSIDE
from tests.support import maps
from tests.support.networks import random_network

SMALL = [
    Architecture(widths, quantiles=(0.25, 0.75), cost_scale=10.0, patch=patch, embedding=embedding)
    for patch, embedding, widths in ((2, 0, (4, 4, 6, 8)), (3, 5, (4, 6)))
]

alone = jax.jit(lambda network, terrain: network.estimate(terrain, ()))


@pytest.fixture(scope="module", params=SMALL, ids=lambda architecture: f"patch {architecture.patch}")
def network(request) -> NetworkCostToGo:
    return random_network(request.param)


@pytest.fixture(scope="module")
def padded(network):
    return jax.jit(lambda grid: PaddedNetwork(network).estimate(grid, ()))


# Odd and even numbers of cells after none to four halvings; one that fills the grid; two that are resampled.
@pytest.mark.parametrize(
    "shape", [(1, 1), (2, 3), (17, 32), (25, 26), (40, 50), (37, 61), (64, 9)], ids="{0[0]}x{0[1]}".format
)
def test_the_answer_is_that_to_the_map_alone(network, padded, shape):
    terrain = maps.random_terrain(sum(shape), shape, 0.6)
    terrain[maps.random_cells(sum(shape), shape, 0.5)] = 0
    wanted = np.asarray(alone(network, terrain))
    for grid_shape, place in (((64, 64), (0, 0)), ((70, 96), (0, 0)), ((70, 96), (6, 35))):
        grid = np.full(grid_shape, OUTSIDE, np.uint8)
        rows, columns = (slice(first, first + side) for first, side in zip(place, shape, strict=True))
        grid[rows, columns] = terrain
        np.testing.assert_allclose(np.asarray(padded(grid))[:, rows, columns], wanted, rtol=1e-4, atol=1e-4)
    assert padded._cache_size() <= 2


@pytest.mark.parametrize("grid_shape", [(4, 64), (64, 3), (1, 20)], ids="{0[0]}x{0[1]}".format)
def test_a_grid_that_is_halved_to_one_row_before_its_columns_are(network, grid_shape):
    shape = tuple(min(side, 18) for side in grid_shape)
    terrain = maps.random_terrain(1, shape, 0.6)
    grid = np.full(grid_shape, OUTSIDE, np.uint8)
    grid[: shape[0], : shape[1]] = terrain
    answer = np.asarray(jax.jit(PaddedNetwork(network).estimate)(grid, ()))[:, : shape[0], : shape[1]]
    np.testing.assert_allclose(answer, np.asarray(alone(network, terrain)), rtol=1e-4, atol=1e-4)


def test_a_summarized_network_computes_the_mean(network, padded):
    terrain = maps.random_terrain(2, (17, 32), 0.6)
    mean = PaddedNetwork(network).summarized(functools.partial(jnp.mean, axis=0, keepdims=True))
    answer = np.asarray(jax.jit(mean.estimate)(terrain, ()))
    np.testing.assert_allclose(answer, np.mean(padded(terrain), axis=0, keepdims=True), rtol=1e-4, atol=1e-4)


def test_where_the_map_ends_makes_a_difference(padded):
    grid = np.full((32, 32), OUTSIDE, np.uint8)
    grid[:20, :20] = 3
    beyond = np.where(grid == OUTSIDE, 0, grid).astype(np.uint8)
    answer, other = (np.asarray(padded(each))[:, :20, :20] for each in (grid, beyond))
    assert np.abs(answer - other).max() > 1e-2
