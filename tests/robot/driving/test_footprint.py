import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dc2g_jax.robot.driving.footprint import Ground, blocked_around, cell_at, cell_centers, clearance
from tests.oracles import vehicle_oracle
from tests.support.maps import random_cells, seeds

CELL_SIZE, REACH = 0.8, 1.5


@pytest.fixture(scope="module")
def clearances():
    return jax.jit(
        lambda cells, place, points: clearance(points, blocked_around(Ground(cells, CELL_SIZE), place, REACH))
    )


@settings(max_examples=30)
@given(seed=seeds, density=st.sampled_from([0.3, 0.8, 1.0]))
def test_clearance_is_the_distance_to_the_nearest_blocked_cell(clearances, seed, density):
    free, rng = random_cells(seed, (6, 7), density), np.random.default_rng(seed)
    position = rng.uniform([0, -6], [7, 0]) * CELL_SIZE
    angle, distance = rng.uniform(0, 7, 40), rng.uniform(0, REACH, 40)
    points = position + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    found = np.asarray(clearances(free, position.astype(np.float32), points.astype(np.float32)))
    expected = vehicle_oracle.clearance(points, free, CELL_SIZE)
    # Exact as far as it was asked for; what is further off is never taken to be nearer than that.
    near = expected + distance < REACH - 1e-4
    np.testing.assert_allclose(found[near], expected[near], atol=1e-5)
    assert np.all(found >= expected - 1e-5)


def test_cells_and_their_centers():
    cells = jnp.array([[0, 0], [3, 2], [-1, 4]])
    centers = cell_centers(cells, 0.5)
    np.testing.assert_allclose(centers, [[0.25, -0.25], [1.75, -1.25], [-0.25, -2.25]])
    assert cell_at(centers, 0.5).tolist() == cells.tolist()
