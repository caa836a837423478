"""Slow, obviously right ray casting: every tile is a box, every ray is held against every box, in double precision.

A box is met where the ray has entered all three of its slabs and left none. The world is as in
`mapping.camera`.
"""

from typing import NamedTuple

import numpy as np

FLOOR = -1.0  # the boxes reach a meter into the ground, so that flat tiles are boxes too

Array = np.ndarray


class Met(NamedTuple):
    """What rays meet first: time along the ray (0 for nothing), row, column and face (0 x, 1 y, 2 top) of the tile."""

    time: Array
    row: Array
    column: Array
    face: Array


def nearest_boxes(heights: Array, tile_size: float, origin: Array, directions: Array, max_range: float) -> Met:
    """Cast rays, [n 3], from one place into a field of heights, [h w]. Nothing is met from inside a box."""
    rows, columns = np.indices(heights.shape)
    low = np.stack([columns * tile_size, -(rows + 1) * tile_size, np.full(heights.shape, FLOOR)]).reshape(3, -1)
    high = np.stack([(columns + 1) * tile_size, -rows * tile_size, heights]).reshape(3, -1)
    met = [_nearest_box(low, high, np.asarray(origin, float), np.asarray(ray, float)) for ray in directions]
    time, box, face = (np.array(values) for values in zip(*met, strict=True))
    time = np.where(time * np.linalg.norm(directions, axis=-1) <= max_range, time, 0.0)
    return Met(time, box // heights.shape[1], box % heights.shape[1], face)


def _nearest_box(low: Array, high: Array, origin: Array, ray: Array) -> tuple[float, int, int]:
    """One ray, [3], and boxes from `low` to `high`, [3 boxes]: time, number of the box, face."""
    origin, ray = origin[:, None], ray[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - origin) / ray, (high - origin) / ray
    entered, left = np.minimum(first, second), np.maximum(first, second)
    # A ray along a slab is either between its sides for ever or never.
    along = np.broadcast_to(ray == 0, entered.shape)
    between = (low <= origin) & (origin <= high)
    entered[along] = np.where(between, -np.inf, np.inf)[along]
    left[along] = np.where(between, np.inf, -np.inf)[along]
    start, end = entered.max(axis=0), left.min(axis=0)
    is_met = (start < end) & (end > 0)
    if not is_met.any() or np.any(is_met & (start <= 0)):
        return 0.0, 0, 2
    box = int(np.argmin(np.where(is_met, start, np.inf)))
    return float(start[box]), box, int(np.argmax(entered[:, box]))
