"""Grids in a map frame like that of ROS, in meters, with y upward."""

import math
from typing import NamedTuple


class MapFrame(NamedTuple):
    """Where a grid lies in the map frame.

    Attributes:
      x: position of the lower left corner of the grid, meters.
      y: the same, meters.
      yaw: counterclockwise rotation of the grid about that corner, radians.
    """

    x: float
    y: float
    yaw: float

    def to_grid(self, x: float, y: float) -> tuple[float, float]:
        """A point of the map frame as meters to the right of the corner along the grid's rows, and meters up."""
        east, north = x - self.x, y - self.y
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return east * cos + north * sin, north * cos - east * sin

    def to_map(self, right: float, up: float) -> tuple[float, float]:
        """The inverse of `to_grid`."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + right * cos - up * sin, self.y + right * sin + up * cos
