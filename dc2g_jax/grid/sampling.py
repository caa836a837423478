"""Sampling a semantic picture of any size onto a square grid of cells."""

import cv2
import numpy as np
import numpy.typing as npt

from dc2g_jax.grid.terrain import FRONT_DOOR, PATH

ClassImage = npt.NDArray[np.uint8]


def sample_grid(classes: ClassImage, cells: int = 50) -> ClassImage:
    """Squeeze a class image into a square grid, whatever its aspect ratio.

    Nearest neighbour at pixel centres, exact ties rounded down: along an axis of n pixels, cell i reads pixel
    (n (2 i + 1) - 1) // (2 cells). Then `path` cells are dilated by a 3x3 square over everything, so that a
    thin path stays connected, and `front_door` cells are put back on top.

    Args:
        classes: class indices, uint8 [H W].
        cells: side of the grid.

    Returns:
        Class indices, uint8 [cells cells].

    Raises:
        ValueError: if `classes` is not a non-empty two-dimensional array, or `cells` is not positive.
    """
    if classes.ndim != 2 or classes.size == 0:
        raise ValueError(f"classes must be a non-empty [H W] array, got shape {classes.shape}")
    if cells < 1:
        raise ValueError(f"cells must be positive, got {cells}")
    rows, columns = ((n * (2 * np.arange(cells) + 1) - 1) // (2 * cells) for n in classes.shape)
    sampled = classes[np.ix_(rows, columns)]
    path = cv2.dilate((sampled == PATH).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return np.where(path & (sampled != FRONT_DOOR), np.uint8(PATH), sampled).astype(np.uint8)
