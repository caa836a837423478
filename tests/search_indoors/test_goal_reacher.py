"""Paths to an object that has been seen, against plain loops and values known by hand."""

from collections import deque

import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.search_indoors.maps.cost_maps import ARM, STOP, distance_to_object, without_specks


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
