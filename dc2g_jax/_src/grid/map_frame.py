"""Grids in a map frame like that of ROS, in meters, with y upward."""

import math
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

#: Meters: a number, or an array of them.
_Meters = TypeVar("_Meters", float, npt.NDArray[np.floating])


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

    def to_grid(self, x: _Meters, y: _Meters) -> tuple[_Meters, _Meters]:
        """Points of the map frame as meters to the right of the corner along the grid's rows, and meters up."""
        east, north = x - self.x, y - self.y
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return east * cos + north * sin, north * cos - east * sin

    def to_map(self, right: _Meters, up: _Meters) -> tuple[_Meters, _Meters]:
        """The inverse of `to_grid`."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + right * cos - up * sin, self.y + right * sin + up * cos
