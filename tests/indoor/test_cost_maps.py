"""Cost maps of a round vehicle against plain loops and against values known by hand."""

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.maps import cost_maps as cost_maps
from dc2g_jax.indoor.maps.cost_maps import ARM, STOP, distance_to_object, without_specks


@pytest.mark.parametrize("radius", [0.05, 0.2, 0.33])
def test_a_disc_covers_a_part_of_an_obstacle_where_the_map_is_inflated(radius):
    cells = np.random.default_rng(0).random((23, 31)) < 0.02
    inflated = np.asarray(cost_maps.inflated(jnp.asarray(cells), radius, 0.1))
    obstacles = np.argwhere(cells)
    for row, column in np.ndindex(cells.shape):
        off = np.maximum(np.abs(obstacles - (row, column)) - 0.5, 0)
        nearest = np.hypot(*off.T).min() * 0.1
        assert inflated[row, column] == (nearest < radius or cells[row, column]), (row, column)


def test_distances_lead_over_furniture_and_not_through_walls():
    goals, walls = np.zeros((2, 30, 30), bool)
    goals[15, 10] = walls[5:25, 13] = True
    found = np.asarray(cost_maps.straight_distance(jnp.asarray(goals), jnp.asarray(walls), 0.1, 0.7))
    straight = 0.1 * np.hypot(*(np.mgrid[:30, :30] - np.array([15, 10])[:, None, None]))
    near = (straight <= 0.7 + 1e-6) & (np.arange(30) < 13)
    np.testing.assert_allclose(found[near], straight[near], atol=1e-6)
    assert np.isinf(found[~near]).all()


def test_costs_are_the_distance_and_lead_back_to_it():
    distance = np.full((9, 12), np.inf, np.float32)
    distance[4, 2:6] = [0.3, 0.2, 0.1, 0.0]
    costs = np.asarray(cost_maps.dense_costs(jnp.asarray(distance), 0.1, collision=7.0, slope=20.0))
    np.testing.assert_allclose(costs[4, 2:6], distance[4, 2:6])
    np.testing.assert_allclose(costs[4, 6:9], 7 + 2 * np.array([1, 2, 3]), rtol=1e-6)
    assert np.isfinite(costs).all()
    assert (costs[np.isinf(distance)] > 7).all()


def test_costs_are_even_where_there_is_no_distance_at_all():
    costs = cost_maps.dense_costs(jnp.full((9, 12), jnp.inf), 0.1, collision=7.0)
    np.testing.assert_array_equal(costs, np.full((9, 12), 7, np.float32))


def test_costs_are_looked_up_between_the_centers_of_cells():
    costs = np.arange(12.0, dtype=np.float32).reshape(3, 4) ** 2
    cost_of_pose = jax.jit(cost_maps.cost_lookup(jnp.asarray(costs), 0.5, outside=-1.0))
    # x along columns, y against rows.
    places = [(0.25, -0.25), (1.75, -1.25), (0.5, -0.75), (1.25, -1.0), (-3, -1), (1, 4)]
    expected = [0, 121, (16 + 25) / 2, (36 + 100) / 2, -1, -1]
    found = [cost_of_pose(jnp.array(place, jnp.float32), jnp.float32(0.3)) for place in places]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def distances(obstacles, walls, goals):
    cells = (jnp.asarray(one) for one in (obstacles, walls, goals))
    return np.asarray(distance_to_object(*cells, radius=0.2, cell_size=0.1))


def test_specks_go_and_objects_stay():
    cells = np.random.default_rng(1).random((20, 30)) < 0.06
    kept = np.asarray(without_specks(jnp.asarray(cells)))
    for row, column in np.ndindex(cells.shape):
        around = cells[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].sum()
        assert kept[row, column] == (cells[row, column] and around >= 3)
    assert 0 < kept.sum() < cells.sum()


def test_the_path_ends_at_arms_length_from_a_plant_on_a_table():
    obstacles, goals = np.zeros((2, 40, 60), bool)
    obstacles[15:25, 30:40] = True
    goals[19:21, 34:36] = True
    nothing = np.zeros_like(goals)
    distance = distances(obstacles, nothing, goals)
    # The nearest place to stand is beside the table, 0.7 m from the plant.
    assert distance[20, 27] == distance[20, 26] == 0 < distance[20, 25]
    # 24 cells to the plant, less an arm's length.
    np.testing.assert_allclose(distance[20, 10], 2.4 - ARM, atol=0.1)
    assert np.isinf(distance[18, 31])
    walled = distances(obstacles, obstacles & ~goals, goals)
    assert np.isinf(walled).all()


def test_what_an_arm_lacks_counts_in_full():
    obstacles, goals = np.zeros((2, 40, 60), bool)
    obstacles[10:30, 28:42] = True
    goals[20, 35] = True
    distance = distances(obstacles, np.zeros_like(goals), goals)
    # Two cells off the table it is 10 cells to the plant, 0.2 m more than an arm's length: near enough to stop.
    np.testing.assert_allclose(distance[20, 25], 1.0 - ARM, atol=1e-4)
    assert distance[20, 25] <= STOP + 1e-4
    np.testing.assert_allclose(distance[20, 15], 1.0 - ARM + 1.0, atol=1e-4)


def test_ways_lead_everywhere_that_a_queue_finds():
    rng = np.random.default_rng(3)
    obstacles = rng.random((40, 40)) < 0.03
    goals = np.zeros_like(obstacles)
    goals[20:23, 20:23] = True
    obstacles |= goals
    found = distances(obstacles, obstacles & ~goals, goals)
    queue = deque([tuple(cell) for cell in np.argwhere(found <= STOP)])
    reached = set(queue)
    offsets = np.argwhere(obstacles)
    gap = np.array(
        [[np.hypot(*np.maximum(np.abs(offsets - (r, c)) - 0.5, 0).T).min() for c in range(40)] for r in range(40)]
    )
    while queue:
        row, column = queue.popleft()
        for beside in ((row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)):
            if beside not in reached and min(beside) >= 0 and max(beside) < 40 and gap[beside] >= 2:
                reached.add(beside)
                queue.append(beside)
    assert reached == {tuple(cell) for cell in np.argwhere(np.isfinite(found))}
    assert 100 < len(reached) < 1500
