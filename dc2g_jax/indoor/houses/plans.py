"""Plans of furnished houses in meters, and their rasterization to a world of cells.

Plan frame: x to the right, y up, angles counter-clockwise from x.

A grid of heights holds only the highest object of each cell, solid from the floor up. A plant on a table therefore
occupies the cells below its own box up to its top, and the table keeps its other cells. Objects under a table top and
the space between table legs are lost. A television on a wall reaches down to the floor. No object extends through a
wall or into another room. An object that is too thin for the grid is widened by the width of a cell.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.runtime import InputError, check_number

#: Side of a cell, meters: the paper's map of 420 cells is then 21 m wide.
PLAN_CELL_SIZE = 0.05

#: Height of walls, and their thickness unless cells are larger; meters.
_WALL_HEIGHT = 2.5
_WALL_THICKNESS = 0.1

#: Margin of the grid around a house, meters. With cells of 5 or 10 cm, walls on whole decimeters then fill whole cells.
MARGIN = 0.25

#: Largest number of cells along a side of a grid.
MOST_CELLS = 4096

#: Tolerance for centers of cells on the border of a box, meters: rounding errors must not open walls.
_ROUNDING = 1e-6


class Room(NamedTuple):
    """A room.

    Attributes:
      kind: index into `maps.classes.ROOM_NAMES`.
      outline: corners of its floor in order, [corner 2].
    """

    kind: int
    outline: Float[np.ndarray, "corner 2"]


class Segment(NamedTuple):
    """A straight segment of a wall, given by its ends (x, y)."""

    start: tuple[float, float]
    end: tuple[float, float]


class Furniture(NamedTuple):
    """An object as an upright box.

    Attributes:
      kind: class index, see `maps.classes`.
      x: x of its center, meters.
      y: y of its center, meters.
      width: extent along its own x axis, meters.
      depth: extent along its own y axis, meters.
      angle: angle of its own x axis, radians.
      top: height of its top above the floor, meters.
    """

    kind: int
    x: float
    y: float
    width: float
    depth: float
    angle: float
    top: float


@dataclass(frozen=True, eq=False)
class HousePlan:
    """A furnished house.

    Attributes:
      rooms: at least one room; rooms do not overlap.
      walls: walls; those that two rooms share may occur twice.
      doors: open segments of walls. All doors of a plan are open.
      furniture: furniture in any order.
    """

    rooms: tuple[Room, ...]
    walls: tuple[Segment, ...]
    doors: tuple[Segment, ...]
    furniture: tuple[Furniture, ...]


class _Grid(NamedTuple):
    """A grid over a plan: x of the left edge, y of the upper edge, x and y of cells' centers, and side of a cell."""

    left: float
    top: float
    x: Float[np.ndarray, "w"]
    y: Float[np.ndarray, "h"]
    cell_size: float

    @classmethod
    def over(cls, plan: HousePlan, cell_size: float) -> "_Grid":
        """The grid that covers all rooms and walls."""
        corners = np.concatenate([*(room.outline for room in plan.rooms), *(np.array(wall) for wall in plan.walls)])
        (left, bottom), (right, top) = (corners.min(axis=0) - MARGIN).tolist(), (corners.max(axis=0) + MARGIN).tolist()
        height, width = top - bottom, right - left
        if not max(height, width) <= MOST_CELLS * cell_size:
            size = f"{width:.4g} x {height:.4g} m"
            raise InputError(f"a house of {size} has more than {MOST_CELLS} cells a side; give meters, or larger cells")
        down, along = (
            (np.arange(math.ceil(side / cell_size - _ROUNDING)) + 0.5) * cell_size for side in (height, width)
        )
        return cls(left, top, left + along, top - down, cell_size)

    def around(self, points: Float[np.ndarray, "point 2"], reach: float) -> tuple[slice, slice]:
        """The rows and columns of cells whose center is within reach of the box around some points; possibly none."""
        (left, bottom), (right, top) = points.min(axis=0) - reach, points.max(axis=0) + reach
        rows, columns = np.searchsorted(-self.y, (-top, -bottom)), np.searchsorted(self.x, (left, right))
        return slice(*rows), slice(*columns)


def world_from_plan(plan: HousePlan, cell_size: float = PLAN_CELL_SIZE) -> IndoorWorld:
    """Rasterize a house to cells of `cell_size` meters. A cell belongs to whatever contains its center.

    Objects whose center is outside all rooms are left out.

    Raises:
      InputError: the cell size is not positive, or the grid would have more than `MOST_CELLS` cells along a side.
    """
    check_number("cell size", cell_size, above=0, hint="meters")
    grid = _Grid.over(plan, cell_size)
    floor = _floor(grid, plan.rooms)
    walls = _walls(grid, plan)
    rooms = np.where(walls, 0, floor).astype(np.uint8)
    heights = np.where(walls, _WALL_HEIGHT, 0).astype(np.float32)
    instances = np.full(heights.shape, -1, np.int16)
    housed = [entry for entry in zip(plan.furniture, _rooms_at(plan), strict=True) if entry[1]]
    # In order of height: the highest object covers the others.
    for number, (piece, room) in sorted(enumerate(housed), key=lambda entry: entry[1][0].top):
        place, cells = _footprint(grid, piece, rooms, room)
        heights[place][cells] = piece.top
        instances[place][cells] = number
    kinds = np.array([piece.kind for piece, _ in housed], np.uint8)
    return IndoorWorld(
        free=(rooms > 0) & (instances < 0),
        heights=heights,
        classes=np.append(kinds, np.uint8(0))[instances],
        instances=instances,
        rooms=rooms,
        room_kinds=np.array([0, *(room.kind for room in plan.rooms)], np.uint8),
        object_kinds=kinds,
        cell_size=np.asarray(cell_size, np.float32),
    )


def _rooms_at(plan: HousePlan) -> list[int]:
    """The number of the room that contains the center of each piece of furniture, counted from 1; 0 outside."""
    x, y = np.array([(piece.x, piece.y) for piece in plan.furniture]).reshape(-1, 2).T
    found = np.zeros(len(x), int)
    for number, room in enumerate(plan.rooms, 1):
        found[_inside(room.outline, x, y)] = number
    return found.tolist()


def _inside(
    outline: Float[np.ndarray, "corner 2"], x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]
) -> Bool[np.ndarray, "..."]:
    """Whether points lie within an outline, by the even-odd rule for a ray to the right."""
    inside = np.zeros(np.broadcast_shapes(x.shape, y.shape), bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 != y1:
            passes = (y >= min(y0, y1)) & (y < max(y0, y1))
            inside ^= passes & (x < x0 + (y - y0) * ((x1 - x0) / (y1 - y0)))
    return inside


def _floor(grid: _Grid, rooms: tuple[Room, ...]) -> UInt8[np.ndarray, "h w"]:
    floor = np.zeros((len(grid.y), len(grid.x)), np.uint8)
    for number, room in enumerate(rooms, 1):
        rows, columns = grid.around(room.outline, grid.cell_size)
        floor[rows, columns][_inside(room.outline, grid.x[columns], grid.y[rows, None])] = number
    return floor


def _walls(grid: _Grid, plan: HousePlan) -> Bool[np.ndarray, "h w"]:
    walls = np.zeros((len(grid.y), len(grid.x)), bool)
    for wall in plan.walls:
        place, cells = _strip(grid, wall, 1.0)
        walls[place] |= cells
    for door in plan.doors:
        # Two walls back to back may have a small gap between them.
        place, cells = _strip(grid, door, 2.0)
        walls[place] &= ~cells
    return walls


def _strip(grid: _Grid, segment: Segment, thickness: float) -> tuple[tuple[slice, slice], Bool[np.ndarray, "h w"]]:
    """The window around a strip along a segment, `thickness` times as thick as a wall, and its cells there.

    Walls are thick enough that no step between cells, not even a diagonal one, leads through them. They end half a
    thickness beyond their ends, so that corners are closed. Openings end exactly at their ends.
    """
    (x0, y0), (x1, y1) = segment
    length = math.hypot(x1 - x0, y1 - y0) or 1.0
    along = (x1 - x0) / length, (y1 - y0) / length
    wall = max(_WALL_THICKNESS, grid.cell_size * (abs(along[0]) + abs(along[1])))
    angle = math.atan2(along[1], along[0])
    box = Furniture(0, (x0 + x1) / 2, (y0 + y1) / 2, math.hypot(x1 - x0, y1 - y0), thickness * wall, angle, 0)
    return _covered(grid, box if thickness > 1 else box._replace(width=box.width + wall))


def _footprint(
    grid: _Grid, piece: Furniture, rooms: UInt8[np.ndarray, "h w"], room: int
) -> tuple[tuple[slice, slice], Bool[np.ndarray, "rows columns"]]:
    """The window around an object, and its cells there that lie within its room."""
    place, cells = _covered(grid, piece)
    cells &= rooms[place] == room
    if not cells.any():
        wider = piece._replace(width=piece.width + 2 * grid.cell_size, depth=piece.depth + 2 * grid.cell_size)
        place, cells = _covered(grid, wider)
        cells &= rooms[place] == room
    return place, cells


def _covered(grid: _Grid, box: Furniture) -> tuple[tuple[slice, slice], Bool[np.ndarray, "h w"]]:
    """The window around a box, and the cells there whose center lies in the box."""
    cosine, sine = math.cos(box.angle), math.sin(box.angle)
    rows, columns = grid.around(np.array([[box.x, box.y]]), math.hypot(box.width, box.depth) / 2 + grid.cell_size)
    x, y = grid.x[columns] - box.x, grid.y[rows, None] - box.y
    cells = np.abs(x * cosine + y * sine) <= box.width / 2 + _ROUNDING
    return (rows, columns), cells & (np.abs(y * cosine - x * sine) <= box.depth / 2 + _ROUNDING)
