"""Distances that a vehicle has to drive until it touches a goal, against values known by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.maps.cost_maps import inflated, with_tight_cells
from experiments.objectnav.collecting import distance_for_vehicle


def test_a_vehicle_drives_through_a_door_only_if_it_fits():
    obstacles, goals = np.zeros((2, 20, 30), bool)
    obstacles[:, 15] = True
    obstacles[6:14, 15] = False
    goals[10, 28] = True

    def from_other_side(radius):
        return np.asarray(distance_for_vehicle(jnp.asarray(obstacles), jnp.asarray(goals), radius, 0.1)[10, 2])

    # 26 cells to the goal's middle; the goal is touched earlier.
    np.testing.assert_allclose(from_other_side(0.3), 2.6 - 0.3, atol=0.11)
    assert np.isinf(from_other_side(0.45))


def test_no_path_leads_through_a_gap_that_is_too_tight():
    free = np.ones((20, 30), bool)
    free[:, 15] = False
    free[10, 15] = True  # too narrow for the robot
    free[2:5, 5], free[2:5, 7] = False, False  # and so is the floor between these
    goals = np.zeros_like(free)
    goals[17, 2] = True
    free, goals = jnp.asarray(free), jnp.asarray(goals)
    fits = ~inflated(~free, 0.2, 0.1)
    distance = distance_for_vehicle(~free, goals, 0.2, 0.1)
    filled = np.asarray(with_tight_cells(distance, free, fits, 0.1))
    fits, known = np.asarray(fits), np.isfinite(np.asarray(distance))
    assert (fits & ~known)[:, 18:].any()
    np.testing.assert_array_equal(filled[fits], np.asarray(distance)[fits])  # no path through the gap
    assert not fits[3, 6]
    assert 1.2 < filled[3, 6] < 1.6  # out of the gap, then as the crow flies until it touches the goal
    assert np.isinf(filled[~np.asarray(free)]).all()


@pytest.mark.parametrize("thick", [1, 2])
def test_a_goal_is_touched_on_the_near_side_of_a_wall(thick):
    obstacles, goals = np.zeros((2, 20, 30), bool)
    obstacles[:, 16 - thick : 16] = True
    obstacles[8:12, 16:18] = goals[8:12, 16:18] = True
    distance = np.asarray(distance_for_vehicle(jnp.asarray(obstacles), jnp.asarray(goals), 0.25, 0.1))
    assert np.isinf(distance[:, : 16 - thick]).all()
    assert np.isfinite(distance[10, 18:]).all()
    np.testing.assert_allclose(distance[10, [18, 19, 24]], [0, 0, 0.5], atol=0.11)
