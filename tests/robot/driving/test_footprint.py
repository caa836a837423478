import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dc2g_jax.robot.driving.footprint import (  # fmt: skip
    Ground,
    blocked_around,
    cell_at,
    cell_centers,
    clearance,
    distance_to_segment,
    needed_clearance,
)
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


@settings(max_examples=30)
@given(seed=seeds)
def test_what_is_clear_at_both_ends_of_an_arc_is_clear_all_along(seed):
    rng = np.random.default_rng(seed)
    radius, traveled, turned = rng.uniform(0.1, 0.5), rng.uniform(0, 0.4), rng.uniform(-0.6, 0.6)
    places = vehicle_oracle.driven([0, 0], rng.uniform(-3, 3), traveled, turned, 1.0, 50)
    needed = float(needed_clearance(radius, jnp.float32(traveled), jnp.float32(turned), jnp.float32(np.inf)))
    obstacles = rng.uniform(-1, 1, (400, 2)) * (radius + traveled)
    apart = np.linalg.norm(obstacles[:, None] - places, axis=-1)
    clear = np.minimum(apart[:, 0], apart[:, -1]) >= needed
    assert apart[clear].min(initial=np.inf) > radius
    assert needed <= np.hypot(radius + 0.001 + traveled * abs(turned) / 8, traveled / 2) + 1e-6


def test_a_footprint_that_touches_blocked_ground_need_only_touch_it_no_deeper():
    needed = needed_clearance(0.3, jnp.array([0.0, 0.2]), 0.0, jnp.float32(0.2))
    assert needed.tolist() == pytest.approx([0.2, 0.2])


def test_distance_to_a_segment():
    segment = jnp.array([1.0, 1.0]), jnp.array([2.0, 0.0])
    for point, expected in (((2.5, 3.0), 2.0), ((0.0, 1.0), 1.0), ((6.0, 5.0), 5.0)):
        assert float(distance_to_segment(jnp.array(point), *segment)) == pytest.approx(expected)
    assert float(distance_to_segment(jnp.array([4.0, 5.0]), segment[0], jnp.zeros(2))) == pytest.approx(5)
