"""Robots' own maps, in meters in the map frame, and how the planner reads them."""

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from jaxtyping import UInt8

from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.grid.poses import FORWARD, HEADINGS
from dc2g_jax._src.grid.sampling import sample_conservatively
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FREE, FRONT_DOOR, NOTHING, OCCUPIED, TRAVERSABLE, UNKNOWN
from dc2g_jax._src.planning.decisions import RobotPose
from dc2g_jax._src.planning.inputs import map_of, numbers_of
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number

#: An occupancy grid's cell is free up to the first value, occupied from the second, in percent, and unknown between.
#: Nav2 saves maps with these thresholds.
FREE_AT_MOST, OCCUPIED_FROM = 25, 65

#: Largest cell value of an occupancy grid, and of any map.
_OCCUPIED, _MOST = 100, 127

#: Marks values without a class.
_NO_CLASS = 255

#: Largest distance of a map from the origin of its frame, in meters.
_FARTHEST = 1e7

_QUARTER = 2 * math.pi / HEADINGS


class MetricPose(NamedTuple):
    """A pose in the map frame.

    Attributes:
      x: meters.
      y: meters.
      yaw: radians, counterclockwise from the x-axis.
    """

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, eq=False)
class MetricMap:
    """A map like a `nav_msgs/OccupancyGrid`.

    Attributes:
      cells: integers `[h w]`, -1 where unknown, up to 127. The first row is the lowest: y grows upward. Lists become
        an array.
      resolution: side of a cell, meters.
      origin: where the grid lies in the map frame: a `MapFrame`, or x, y and yaw.

    Raises:
      InputError: a value is invalid.
    """

    cells: npt.NDArray[np.integer]
    resolution: float
    origin: MapFrame

    def __post_init__(self) -> None:
        cells = map_of("the map", self.cells, np.integer, "int8 [rows columns]")
        for value in (int(cells.min()), int(cells.max())):
            check_number("a cell of the map,", value, least=-1, most=_MOST, hint="(-1: unknown)")
        check_number("the map's resolution", self.resolution, above=0, hint="in meters a cell, such as 0.05")
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "origin", MapFrame(*in_map_frame("the map's origin", self.origin, 3)))


class Cells(NamedTuple):
    """The planner's cells in the map frame. Rows grow downward.

    Attributes:
      frame: frame whose corner is the lower left corner of column 0, row -1.
      size: side of a cell, meters.
    """

    frame: MapFrame
    size: float

    def pose_in(self, pose: MetricPose) -> RobotPose:
        """The cell that holds a pose, and the nearest quarter turn."""
        right, up = self.frame.to_grid(pose.x, pose.y)
        turns = round((self.frame.yaw - pose.yaw) / _QUARTER)
        return RobotPose(math.floor(right / self.size), -1 - math.floor(up / self.size), turns % HEADINGS)

    def centers(self, poses: Iterable[tuple[Any, ...]]) -> list[MetricPose]:
        """Poses at the centers of cells, given column, row and heading of each; anything after these is ignored."""
        x, y, heading = np.array([pose[:3] for pose in poses], np.intp).reshape(-1, 3).T
        yaws = [math.remainder(self.frame.yaw - turns * _QUARTER, math.tau) for turns in range(HEADINGS)]
        middles = self.frame.to_map((x + 0.5) * self.size, -(y + 0.5) * self.size)
        return list(map(MetricPose, *(values.tolist() for values in (*middles, np.array(yaws)[heading]))))


class DrawnMap(NamedTuple):
    """The known part of a map, as the planner reads it.

    Attributes:
      terrain: class indices.
      left: column of its first cell.
      top: row of its first cell.
      cells: where the cells lie.
      factor: pixels of the map along a side of a cell.
      aside: number of unknown cells that are set aside.
      on_ground: whether the robot's cell is traversable on the map.
    """

    terrain: UInt8[np.ndarray, "h w"]
    left: int
    top: int
    cells: Cells
    factor: int
    aside: int
    on_ground: bool


def class_of_values(labels: Mapping[int, str] | None) -> UInt8[np.ndarray, "value"]:
    """Class index of each value of a map's cell from 0 to 127, then that of -1; 255 for values without one.

    Args:
      labels: value -> class name, for semantic maps; `None` for occupancy maps.

    Raises:
      InputError: a value or a name is invalid.
    """
    classes = np.full(_MOST + 2, _NO_CLASS, np.uint8)
    if labels is None:
        classes[: _OCCUPIED + 1] = UNKNOWN
        classes[: FREE_AT_MOST + 1] = FREE
        classes[OCCUPIED_FROM : _OCCUPIED + 1] = OCCUPIED
    for value, name in (labels or {}).items():
        check_number("labels: value", value, whole=True, least=0, most=_MOST)
        check_name(f"class, that of value {value} in labels,", name, CLASS_NAMES)
        classes[value] = CLASS_NAMES.index(name)
    classes[-1] = UNKNOWN
    return classes


def draw(
    grid: MetricMap,
    factor: int,
    classes: UInt8[np.ndarray, "value"],
    robot: MetricPose,
    *,
    doors: Iterable[Sequence[float]],
    aside: Set[tuple[int, int, int]],
    margin: int,
) -> DrawnMap:
    """Resample a map to coarser cells, see `grid.sampling.sample_conservatively`.

    Columns and rows count from the origin of the map frame, to within a pixel, so cells stay in place as the map grows.

    Args:
      grid: the map.
      factor: pixels along a side of a cell.
      classes: class index of each value, see `class_of_values`.
      robot: pose of the robot. Its cell is traversable whatever the map says.
      doors: x and y of doors in the map frame.
      aside: results of `beside_ground`; cells for which it still returns the same become `nothing`.
      margin: how far beyond the map's edges doors and cells set aside may lie, in cells.

    Raises:
      InputError: a value has no class, or the robot is off the map.
    """
    size, unturned = grid.resolution, MapFrame(0.0, 0.0, grid.origin.yaw)
    right, up = unturned.to_grid(*grid.origin[:2])
    # Not to the nearest: that of an origin halfway between two pixels would change as the map grows.
    column, lowest = (math.floor(meters / size + 0.3) for meters in (right, up))
    corner = unturned.to_map(right - column * size, up - lowest * size)
    cells = Cells(MapFrame(*corner, grid.origin.yaw), factor * size)
    height, width = grid.cells.shape
    left, beyond, beside = _covering(column, width, factor)
    top, below, above = _covering(-(lowest + height), height, factor)
    here = cells.pose_in(robot)
    if not (left <= here.x < beyond and top <= here.y < below):
        raise InputError(
            f"the robot is at ({robot.x:.2f}, {robot.y:.2f}) m, off the map of {width} x {height} cells of {size:.3g} "
            f"m at ({grid.origin.x:.2f}, {grid.origin.y:.2f}) m; give both in the map frame"
        )
    pixels = np.pad(_terrain(grid, classes)[::-1], (above, beside))
    terrain = np.pad(sample_conservatively(pixels, beyond - left, below - top), margin)
    left, top = left - margin, top - margin
    on_ground = bool(TRAVERSABLE[terrain[here.y - top, here.x - left]])
    if not on_ground:
        terrain[here.y - top, here.x - left] = FREE
    at_doors = (cells.pose_in(MetricPose(x, y, 0.0)) for x, y in doors)
    terrain[_on_map(at_doors, terrain, left, top)] = FRONT_DOOR
    still_aside = aside & beside_ground(aside, terrain, left, top)
    terrain[_on_map(still_aside, terrain, left, top)] = NOTHING
    rows, columns = (np.flatnonzero(np.any(terrain != UNKNOWN, axis=axis)) for axis in (1, 0))
    part = terrain[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    first = int(left + columns[0]), int(top + rows[0])
    return DrawnMap(part, *first, cells, factor, len(still_aside), on_ground)


def beside_ground(
    cells: Iterable[tuple[int, ...]], terrain: UInt8[np.ndarray, "h w"], left: int, top: int
) -> set[tuple[int, int, int]]:
    """Those of the cells that are unknown and beside ground, and which of their neighbors are ground.

    Args:
      cells: column and row of each; anything after these is ignored.
      terrain: a map; what is beyond it is unknown.
      left: column of its first cell.
      top: row of its first cell.

    Returns:
      Column, row, and a bit for each neighbor.
    """
    rows, columns = _on_map(cells, np.pad(terrain, 1), left - 1, top - 1)
    ground = np.pad(TRAVERSABLE[terrain], 2)
    bits = sum(ground[1 + dy :, 1 + dx :][rows, columns].astype(int) << bit for bit, (dx, dy) in enumerate(FORWARD))
    bits *= np.pad(terrain, 1)[rows, columns] == UNKNOWN
    found = zip((columns + left - 1).tolist(), (rows + top - 1).tolist(), bits.tolist(), strict=True)
    return {each for each in found if each[2]}


def _terrain(grid: MetricMap, classes: UInt8[np.ndarray, "value"]) -> UInt8[np.ndarray, "h w"]:
    """Class indices of a map, the lowest row first."""
    terrain = classes[grid.cells]  # the last one is that of -1
    if terrain.max() == _NO_CLASS:
        row, column = np.argwhere(terrain == _NO_CLASS)[0]
        raise InputError(
            f"the map holds {grid.cells[row, column]} in column {column}, row {row}, which has no class; give "
            f"-1 (unknown) to {_OCCUPIED} (occupied), or for a semantic map, name every value in labels"
        )
    return terrain


def _covering(first: int, count: int, factor: int) -> tuple[int, int, tuple[int, int]]:
    """The cells over pixels along an axis: the first, the one after the last, and pixels missing at both ends."""
    start, end = first // factor, -(-(first + count) // factor)
    return start, end, (first - start * factor, end * factor - first - count)


def _on_map(
    cells: Iterable[tuple[int, ...]], terrain: np.ndarray, left: int, top: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns of the cells that lie on a map whose first cell is at `left` and `top`."""
    columns, rows = np.array([each[:2] for each in cells], np.intp).reshape(-1, 2).T - np.array([[left], [top]])
    inside = (rows >= 0) & (rows < terrain.shape[0]) & (columns >= 0) & (columns < terrain.shape[1])
    return rows[inside], columns[inside]


def in_map_frame(name: str, values: npt.ArrayLike, count: int) -> tuple[float, ...]:
    """Check that values are `count` numbers that a place in a map frame may have, and return them."""
    return numbers_of(name, values, count, limit=_FARTHEST)
