"""Sampling of a semantic image of any size onto a grid of cells."""

from typing import Any, TypeVar

import jax
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, PATH, TRAVERSABLE, UNKNOWN
from dc2g_jax._src.runtime.errors import check_number

ClassImage = npt.NDArray[np.uint8]
Grid = TypeVar("Grid", np.ndarray, jax.Array)


def nearest_pixel(index: Any, pixels: Any, samples: Any) -> Any:
    """The pixel of `pixels` along an axis that is nearest to the center of sample `index` of `samples`, all integers.

    Exact ties are rounded down: (n (2 i + 1) - 1) // (2 m).
    """
    return (pixels * (2 * index + 1) - 1) // (2 * samples)


def resize_nearest(grid: Grid, height: int, width: int) -> Grid:
    """Resize a grid `[h w ...]` to `[height width ...]` by nearest neighbor, see `nearest_pixel`."""
    rows = nearest_pixel(np.arange(height), grid.shape[0], height)
    return grid[rows][:, nearest_pixel(np.arange(width), grid.shape[1], width)]


def sample_grid(classes: ClassImage, cells: int | tuple[int, int] = 50) -> ClassImage:
    """Resample a class image of any aspect ratio to a grid.

    Sampling is nearest neighbor, see `nearest_pixel`. `path` cells are then dilated by a 3x3 square over all other
    classes, so that thin paths stay connected, and `front_door` cells are restored on top.

    Args:
        classes: class indices, uint8 [H W].
        cells: side length of a square grid, or columns and rows.

    Returns:
        Class indices, uint8 [rows columns].

    Raises:
        ValueError: `classes` is not a non-empty two-dimensional array.
        InputError: `cells` is less than 1.
    """
    if classes.ndim != 2 or classes.size == 0:
        raise ValueError(f"classes must be a non-empty [H W] array, got shape {classes.shape}")
    columns, rows = (cells, cells) if isinstance(cells, int) else cells
    for name, number in (("columns", columns), ("rows", rows)):
        check_number(name, number, whole=True, least=1)
    sampled = resize_nearest(classes, rows, columns)
    path = ndimage.binary_dilation(sampled == PATH, np.ones((3, 3)))
    return np.where(path & (sampled != FRONT_DOOR), np.uint8(PATH), sampled).astype(np.uint8)


def sample_conservatively(classes: ClassImage, columns: int, rows: int) -> ClassImage:
    """Resample a class image to a coarser grid on which no obstacle and no door is lost.

    A cell covers every pixel that it touches. It is a front door if any of its pixels is. Otherwise it is an obstacle
    if any is, else unknown if any is, else traversable. Of several such classes, it gets the most frequent one.
    """
    if classes.shape == (rows, columns):
        return classes.copy()
    present = np.array([index for index in range(len(CLASS_NAMES)) if np.any(classes == index)], np.uint8)
    doors, unknown, traversable = present == FRONT_DOOR, present == UNKNOWN, TRAVERSABLE[present]
    sampled = np.zeros((rows, columns), np.uint8)
    # Later kinds take precedence.
    for kind in (traversable, unknown, ~(traversable | unknown), doors):
        if np.any(kind):
            pixels = np.stack([_pixels_per_cell(classes == index, columns, rows) for index in present[kind]])
            sampled = np.where(np.any(pixels, axis=0), present[kind][np.argmax(pixels, axis=0)], sampled)
    return sampled


def _pixels_per_cell(pixels: npt.NDArray[np.bool_], columns: int, rows: int) -> npt.NDArray[np.int32]:
    """Number of these pixels that each cell of a grid over an image touches, int32 [rows columns]."""
    height, width = pixels.shape
    if height % rows == 0 and width % columns == 0:
        tall = pixels.reshape(rows, height // rows, width).sum(axis=1, dtype=np.int32)
        return tall.reshape(rows, columns, width // columns).sum(axis=2, dtype=np.int32)
    counts: np.ndarray = pixels
    for axis, cells in enumerate((rows, columns)):
        size, cell = pixels.shape[axis], np.arange(cells + 1)
        first, beyond = cell[:-1] * size // cells, -(-cell[1:] * size // cells)
        # Only every other of the parts from bound to bound is that of a cell; the last bound lies beyond the image.
        bounds = np.stack([first, beyond], axis=-1).ravel()[:-1]
        parts = np.add.reduceat(counts, bounds, axis=axis, dtype=np.int32)
        counts = parts.take(np.arange(0, 2 * cells, 2), axis=axis)
    return counts
