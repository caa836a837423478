"""Numbers of cells in rectangles against plain NumPy."""

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.squares import at_cells, corner_sums, in_rectangle

SHAPE = (7, 11)


@pytest.mark.parametrize("lead", [(), (2,), (2, 3)])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_cells_in_rectangles_are_those_of_slices(lead, batch):
    """Rectangles may extend beyond the map, or be empty."""
    rng, points = np.random.default_rng(0), (40, *batch)
    cells = rng.random((*lead, *SHAPE, *batch)) < 0.5
    left, top = rng.integers(-6, 14, (2, *points))
    right, bottom = left + rng.integers(0, 9, points), top + rng.integers(0, 9, points)
    sums, sides = corner_sums(jnp.asarray(cells), len(lead)), map(jnp.asarray, (left, top, right, bottom))
    found = np.asarray(in_rectangle(sums, *sides))
    assert found.shape == (*lead, *points)
    for point in np.ndindex(points):
        rows = slice(max(0, top[point]), max(0, bottom[point]))
        columns = slice(max(0, left[point]), max(0, right[point]))
        own = cells[(..., *(slice(None),) * 2, *point[1:])][..., rows, columns]
        np.testing.assert_array_equal(found[(..., *point)], own.sum(axis=(-2, -1)))


@pytest.mark.parametrize("lead", [(), (2,)])
def test_values_at_cells(lead):
    rng = np.random.default_rng(0)
    values = rng.random((*lead, *SHAPE, 3)).astype(np.float32)
    y, x = rng.integers(0, np.array(SHAPE)[:, None, None], (2, 20, 3))
    found = np.asarray(at_cells(*map(jnp.asarray, (values, x, y))))
    for point, robot in np.ndindex(20, 3):
        np.testing.assert_array_equal(found[..., point, robot], values[..., y[point, robot], x[point, robot], robot])
