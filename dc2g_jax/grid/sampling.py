"""Sampling of a semantic image of any size onto a grid of cells."""

from typing import Any, TypeVar

import jax
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dc2g_jax.grid.terrain import FRONT_DOOR, PATH

ClassImage = npt.NDArray[np.uint8]
Grid = TypeVar("Grid", np.ndarray, jax.Array)


def nearest_pixels(pixels: int, samples: int) -> npt.NDArray[np.int64]:
    """The pixel that each sample along an axis reads, int64 [samples]; see `nearest_pixel`."""
    return nearest_pixel(np.arange(samples), pixels, samples)


def nearest_pixel(index: Any, pixels: Any, samples: Any) -> Any:
    """The pixel along an axis that is nearest to the center of a sample. Exact ties are rounded down.

    All arguments are integers or integer arrays of NumPy or JAX.

    Args:
        index: index i of the sample.
        pixels: number n of pixels along the axis.
        samples: number m of samples along the axis.

    Returns:
        (n (2 i + 1) - 1) // (2 m).
    """
    return (pixels * (2 * index + 1) - 1) // (2 * samples)


def resize_nearest(grid: Grid, height: int, width: int) -> Grid:
    """Resize a grid `[h w ...]` to `[height width ...]` by nearest neighbor, see `nearest_pixels`."""
    return grid[nearest_pixels(grid.shape[0], height)][:, nearest_pixels(grid.shape[1], width)]


def sample_grid(classes: ClassImage, cells: int | tuple[int, int] = 50) -> ClassImage:
    """Resample a class image of any aspect ratio to a grid.

    Sampling is nearest neighbor, see `nearest_pixels`. `path` cells are then dilated by a 3x3 square over all other
    classes, so that thin paths stay connected, and `front_door` cells are restored on top.

    Args:
        classes: class indices, uint8 [H W].
        cells: side length of a square grid, or columns and rows.

    Returns:
        Class indices, uint8 [rows columns].

    Raises:
        ValueError: `classes` is not a non-empty two-dimensional array, or `cells` is not positive.
    """
    if classes.ndim != 2 or classes.size == 0:
        raise ValueError(f"classes must be a non-empty [H W] array, got shape {classes.shape}")
    columns, rows = (cells, cells) if isinstance(cells, int) else cells
    if min(columns, rows) < 1:
        raise ValueError(f"cells must be positive, got {cells}")
    sampled = resize_nearest(classes, rows, columns)
    path = ndimage.binary_dilation(sampled == PATH, np.ones((3, 3)))
    return np.where(path & (sampled != FRONT_DOOR), np.uint8(PATH), sampled).astype(np.uint8)
