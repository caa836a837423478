"""Geodesic distance against scikit-fmm's fast marching, and against lengths known by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skfmm

from dc2g_jax.indoor.maps import fast_marching

SHAPE = (40, 56)


@pytest.fixture(scope="module")
def distance():
    return jax.jit(fast_marching.geodesic_distance)


def by_scikit_fmm(is_open, goals, cell_size, speed=None):
    """First-order distance, or travel time where there is a speed; infinity where scikit-fmm gives none."""
    front = np.ma.MaskedArray(np.where(goals, 0.0, 1.0), ~is_open)
    if speed is None:
        found = skfmm.distance(front, dx=cell_size, order=1)
    else:
        found = skfmm.travel_time(front, speed, dx=cell_size, order=1)
    return np.ma.filled(found, np.inf)


def random_map(seed, shape):
    """Free cells and goals: scattered obstacles or blocks, few to many, and a few goals in them or beside them."""
    rng = np.random.default_rng(seed)
    free = rng.random(shape) > rng.uniform(0, 0.35)
    if seed % 2:
        free = np.ones(shape, bool)
        for _ in range(rng.integers(1, shape[0] // 2)):
            row, column, height, width = rng.integers((0, 0, 1, 1), (*shape, shape[0] // 3, shape[1] // 3))
            free[row : row + height, column : column + width] = False
    goals = np.zeros(shape, bool)
    for _ in range(rng.integers(1, 4)):
        row, column, size = rng.integers((0, 0, 1), (*shape, 5))
        goals[row : row + size, column : column + size] = True
    return free, goals


@pytest.mark.parametrize("seed", range(24))
def test_as_scikit_fmm_on_random_maps(distance, seed):
    free, goals = random_map(seed, SHAPE)
    expected = by_scikit_fmm(free | goals, goals, 0.05)
    np.testing.assert_allclose(distance(free, goals, 0.05), expected, rtol=1e-5)


def test_as_scikit_fmm_on_a_large_map(distance):
    free, goals = random_map(3, (420, 420))
    expected = by_scikit_fmm(free | goals, goals, 0.05)
    assert np.nanmax(expected[np.isfinite(expected)]) > 5
    np.testing.assert_allclose(distance(free, goals, 0.05), expected, rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_travel_cost_as_scikit_fmm_where_cells_cost_different_amounts(seed):
    free, goals = random_map(seed, SHAPE)
    speed = np.random.default_rng(seed).uniform(0.2, 3, SHAPE)
    is_open = free | goals
    cost_of_cell = np.where(is_open, 1 / speed, np.inf).astype(np.float32)
    found = jax.jit(fast_marching.travel_cost)(cost_of_cell, np.where(goals, 0, np.inf).astype(np.float32))
    np.testing.assert_allclose(found, by_scikit_fmm(is_open, goals, 1.0, speed), rtol=1e-5)


def test_known_costs_count_on_and_fall_where_a_cheaper_way_leads_in():
    cost_of_cell = np.full(SHAPE, np.inf, np.float32)
    cost_of_cell[7, 3:9] = 2
    start = np.full(SHAPE, np.inf, np.float32)
    start[7, 2], start[7, 9], start[7, 8] = 5, 1, 40
    found = jax.jit(fast_marching.travel_cost)(cost_of_cell, start)
    np.testing.assert_allclose(found[7, 1:11], [np.inf, 5, 7, 9, 9, 7, 5, 3, 1, np.inf])


def test_known_costs_may_be_negative():
    cells = jnp.ones((20, 30))
    start = jnp.full((20, 30), jnp.inf).at[4, 5].set(0).at[15, 25].set(3)
    np.testing.assert_allclose(
        fast_marching.travel_cost(cells, start - 9), fast_marching.travel_cost(cells, start) - 9, atol=1e-5
    )


def test_a_winding_corridor_is_as_long_as_its_cells(distance):
    free = np.zeros(SHAPE, bool)
    free[::2] = True
    free[1::4, -1] = free[3::4, 0] = True
    goals = np.zeros(SHAPE, bool)
    goals[0, 0] = True
    found = np.asarray(distance(free, goals, 0.05))
    corners = SHAPE[0] // 2 - 1
    along = (SHAPE[1] - 1) * (corners + 1) + 2 * corners
    # Around each corner a way may cut the inside: it is no longer than along the cells, and not much shorter.
    end = found[SHAPE[0] - 2, 0 if corners % 2 else -1]
    assert along - 4 * corners <= end / 0.05 <= along * (1 + 1e-5)


def test_rows_and_columns_are_exact_and_no_distance_is_too_short(distance):
    goals = np.zeros(SHAPE, bool)
    goals[20, 30] = True
    found = np.asarray(distance(np.ones(SHAPE, bool), goals, 0.1))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    straight = 0.1 * np.hypot(rows - 20, columns - 30)
    np.testing.assert_allclose(found[20], straight[20], rtol=1e-6)
    np.testing.assert_allclose(found[:, 30], straight[:, 30], rtol=1e-6)
    assert (found >= straight * (1 - 1e-6)).all()
    far = straight > 1
    assert (found[far] <= straight[far] * 1.07).all()


def test_no_way_between_obstacles_that_share_a_corner(distance):
    free = np.ones(SHAPE, bool)
    diagonal = np.arange(SHAPE[0])
    free[diagonal, diagonal] = False
    goals = np.zeros(SHAPE, bool)
    goals[0, -1] = True
    found = np.asarray(distance(free, goals, 1.0))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    np.testing.assert_array_equal(np.isfinite(found), columns > rows)


def test_a_goal_inside_an_obstacle_is_reached_from_beside_it(distance):
    free = np.ones(SHAPE, bool)
    free[10:20, 10:20] = False
    goals = np.zeros(SHAPE, bool)
    goals[12:20, 12:18] = True
    found = np.asarray(distance(free, goals, 0.05))
    np.testing.assert_allclose(found[20:24, 15], 0.05 * np.arange(1, 5), rtol=1e-6)
    assert np.isinf(found[10:12, 10:20]).all()


def test_without_a_goal_nothing_is_near(distance):
    assert np.isinf(distance(np.ones(SHAPE, bool), np.zeros(SHAPE, bool), 1.0)).all()


def test_many_maps_at_once_each_as_alone(distance):
    maps = [random_map(seed, SHAPE) for seed in (2, 3, 5)]
    maps[1] = (maps[1][0], np.zeros(SHAPE, bool))
    free, goals = (jnp.stack(part) for part in zip(*maps, strict=True))
    together = jax.jit(jax.vmap(fast_marching.geodesic_distance))(free, goals)
    for one, (its_free, its_goals) in zip(together, maps, strict=True):
        np.testing.assert_allclose(one, distance(its_free, its_goals, 1.0), rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 6), (6, 1)])
def test_maps_of_one_row_or_column(shape):
    goals = np.zeros(shape, bool)
    goals.flat[1] = True
    found = fast_marching.geodesic_distance(jnp.ones(shape, bool), jnp.asarray(goals), 2.0)
    np.testing.assert_allclose(np.ravel(found), [2, 0, 2, 4, 6, 8])
