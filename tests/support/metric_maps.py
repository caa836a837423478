"""Small maps for `MetricPlanner`, turned in the map frame, and places on them."""

import math

import numpy as np

from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.planning.metric import MetricPlanner
from dc2g_jax._src.planning.metric_map import MetricMap, MetricPose
from tests.oracles.metric_oracle import FREE, OCCUPIED, TURNS, UNKNOWN

__all__ = ["FRAME", "FREE", "OCCUPIED", "PIXEL", "REACH", "TURNS", "UNKNOWN", "grid_of", "place", "planner_of"]

#: Meters of a pixel as in a message, which has 32 bits for them, and the sensing range in cells.
PIXEL, REACH = float(np.float32(0.05)), 3

FRAME = MapFrame(-3.2, 7.0, 0.7)


def planner_of(pixels: int = 1, planner="frontier", **options) -> MetricPlanner:
    """One whose cells have so many pixels along a side."""
    size = pixels * 0.05
    return MetricPlanner(planner, cell_size=size, sensing_range=REACH * size, largest=(16, 16), **options)


def grid_of(cells: np.ndarray, frame: MapFrame = FRAME) -> MetricMap:
    return MetricMap(np.asarray(cells, np.int8), PIXEL, frame)


def place(column: float, row: float, turns: int = 0, frame: MapFrame = FRAME) -> MetricPose:
    """The middle of a pixel in the map frame; the row counts from below."""
    right, up = (column + 0.5) * PIXEL, (row + 0.5) * PIXEL
    x = frame.x + right * math.cos(frame.yaw) - up * math.sin(frame.yaw)
    y = frame.y + right * math.sin(frame.yaw) + up * math.cos(frame.yaw)
    return MetricPose(x, y, frame.yaw + turns * math.pi / 2)
